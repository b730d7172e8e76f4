import json
from pathlib import Path
from typing import Any

import pinocchio as pin
import pytest
from so101_description import URDF_PATH

GEOMETRY = Path(__file__).resolve().parents[2] / "data" / "so101_geometry.json"


@pytest.fixture(scope="session")
def geometry() -> dict[str, Any]:
    """Figures of the official arm and of the published module; the file names its sources."""
    return json.loads(GEOMETRY.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def model() -> Any:
    return pin.buildModelFromUrdf(str(URDF_PATH))
