"""Recognise files that a clone without Git LFS leaves in place of large ones."""

POINTER = "is a Git LFS pointer: the file itself was not downloaded"
PULL = "run git lfs pull"


def is_pointer(data: bytes) -> bool:
    return data.startswith(b"version https://git-lfs")
