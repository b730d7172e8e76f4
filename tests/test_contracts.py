"""The architecture is a test: an import in the wrong direction fails here."""

from importlinter.cli import EXIT_STATUS_SUCCESS, lint_imports


def test_imports_follow_the_contracts():
    assert lint_imports(no_cache=True) == EXIT_STATUS_SUCCESS
