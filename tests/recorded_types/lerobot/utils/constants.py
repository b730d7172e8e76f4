import os
from pathlib import Path

ROBOTS = "robots"
TELEOPERATORS = "teleoperators"
HF_LEROBOT_HOME = Path(
    os.getenv("HF_LEROBOT_HOME", Path.home() / ".cache" / "huggingface" / "lerobot")
)
HF_LEROBOT_CALIBRATION = Path(os.getenv("HF_LEROBOT_CALIBRATION", HF_LEROBOT_HOME / "calibration"))
ACTION = "action"
OBS_STR = "observation"
