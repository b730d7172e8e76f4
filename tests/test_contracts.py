"""The import contracts hold: an import in the wrong direction fails here."""

import subprocess
import sys
from pathlib import Path


def test_imports_follow_the_contracts():
    # In a process of its own: import-linter switches off every logger it finds.
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    assert result.returncode == 0, result.stdout
