"""Named poses: the built-in ones, and the user's own in a file.

The user's own lie in ``poses.json`` in the user's data directory::

    {"schema": "so101/poses/1", "poses": [{"name": "over the mug", "q_deg": [10, -40, 35, 60, 0]}]}

A pose has the zeros of the calibration it was saved with, if they are known (schema 2).

Every change reads the file, changes it and writes it while others are kept out, so two programs
that save a pose at the same time both keep theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from so101_motion.common.attributes import suggest
from so101_motion.common.encoder_zeros import KEY, EncoderZeros, shift, zeros_from, zeros_to
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, joint_angles
from so101_motion.common.named_poses import POSES, NamedPose
from so101_motion.files import user_storage

SCHEMA = "so101/poses/1"

MOST = 200  # Most poses that a user may save. Chosen; nobody finds anything in a longer list.


class SavedPoses:
    """Finds, saves, renames and deletes named poses.

    Every method raises ``ConfigError`` for a file that cannot be read or written, or a wrong name.

    Args:
        path: The file of the user's own poses; by default the one in the user's data directory.
        zeros: Tells the zeros of the arm that is to stand so; by default they are not known.
    """

    def __init__(
        self, path: Path | None = None, zeros: Callable[[], EncoderZeros | None] = lambda: None
    ) -> None:
        self._path, self._zeros = path, zeros

    def own(self) -> tuple[NamedPose, ...]:
        """The user's own poses, in the order in which they were saved."""
        path = self.file()
        if not path.exists():
            return ()
        also = (user_storage.with_zeros(SCHEMA),)
        given = user_storage.read(path, schema=SCHEMA, also=also).get("poses")
        if not isinstance(given, list) or len(given) > MOST:
            raise ConfigError("poses", str(path), f"must be a list of {MOST} poses at most")
        return tuple(_pose(number, each) for number, each in enumerate(given, 1))

    def find(self, name: str) -> NamedPose:
        """The pose called ``name``, built in or the user's own, converted to the arm's zeros.

        Raises:
            ConfigError: There is none; the message names the nearest. Or the zeros are another
                arm's; see ``encoder_zeros.shift``.
        """
        known = {pose.name: pose for pose in (*POSES, *self.own())}
        if name not in known:
            raise ConfigError("pose", name, f"is not a pose; {suggest(str(name), known)}")
        pose, now = known[name], self._zeros()
        off = shift(pose.zeros, now, what=f"the pose {name}", file=self.file(), name=name)
        return NamedPose(name=name, q=pose.q + off, zeros=now) if off.any() else pose

    def save(self, name: str, q: Array) -> NamedPose:
        """Save joint angles ``q``, shape (5,), [rad], as ``name``; replaces a pose of that name."""
        pose = NamedPose(name=_free_name(name), q=joint_angles("q", q), zeros=self._zeros())
        with self._changing() as poses:
            poses[pose.name] = pose
        return pose

    def rename(self, name: str, new: str) -> None:
        """Give one of the user's own poses another name."""
        new = _free_name(new)
        with self._changing() as poses:
            _refuse_missing(poses, name)
            if new != name and new in poses:
                raise ConfigError("pose name", new, "is taken; choose another")
            renamed = [replace(p, name=new) if p.name == name else p for p in poses.values()]
            poses.clear()
            poses.update((pose.name, pose) for pose in renamed)

    def delete(self, name: str) -> None:
        """Delete one of the user's own poses."""
        with self._changing() as poses:
            _refuse_missing(poses, name)
            del poses[name]

    def file(self) -> Path:
        """The file of the user's own poses, whether it exists or not."""
        return self._path or user_storage.folder() / "poses.json"

    @contextmanager
    def _changing(self) -> Iterator[dict[str, NamedPose]]:
        """The user's own poses by name; what the block makes of them is written."""
        path = self.file()
        with user_storage.locked(path):
            poses = {pose.name: pose for pose in self.own()}
            yield poses
            if len(poses) > MOST:
                raise ConfigError("poses", len(poses), f"are more than {MOST}; delete some first")
            listed = [
                {"name": name, "q_deg": user_storage.joints_to_deg(pose.q)} | zeros_to(pose.zeros)
                for name, pose in poses.items()
            ]
            has_zeros = any(KEY in each for each in listed)
            schema = user_storage.with_zeros(SCHEMA) if has_zeros else SCHEMA
            user_storage.write(path, {"poses": listed}, schema=schema)


def _pose(number: int, given: object) -> NamedPose:
    if not isinstance(given, dict):
        raise ConfigError(f"pose {number}", given, 'must be {"name": ..., "q_deg": [...]}')
    return NamedPose(
        name=user_storage.checked_name(given.get("name"), what="pose"),
        q=user_storage.joints_from_deg(given.get("q_deg"), key=f"q_deg of pose {number}"),
        zeros=zeros_from(given),
    )


def _free_name(name: str) -> str:
    name = user_storage.checked_name(name, what="pose")
    if name.casefold() in (pose.name for pose in POSES):
        raise ConfigError("pose name", name, "is built in; choose another name")
    return name


def _refuse_missing(poses: Container[str], name: str) -> None:
    if name not in poses:
        raise ConfigError("pose", name, "is not one of your own poses")
