"""Compare the recorded types that ``make test`` uses for LeRobot with the genuine LeRobot."""

import importlib
import inspect
import subprocess
import sys
from pathlib import Path

NAMES = {
    "lerobot.robots": ("Robot", "RobotConfig"),
    "lerobot.teleoperators": ("Teleoperator", "TeleoperatorConfig"),
    "lerobot.cameras": ("CameraConfig",),
    "lerobot.cameras.utils": ("make_cameras_from_configs",),
    "lerobot.motors": ("MotorCalibration",),
}


def described():
    """Names and arguments, a line each; of whichever LeRobot can be imported."""
    for module, names in NAMES.items():
        for name in names:
            yield f"{module}.{name}({', '.join(inspect.signature(_of(module, name)).parameters)})"
    constants = importlib.import_module("lerobot.utils.constants")
    for name in ("ROBOTS", "TELEOPERATORS"):
        yield f"{name} = {getattr(constants, name)}"
    errors = importlib.import_module("lerobot.utils.errors")
    for name in ("DeviceNotConnectedError", "DeviceAlreadyConnectedError"):
        yield f"{name} is a {getattr(errors, name).__mro__[1].__name__}"


def _of(module, name):
    return getattr(importlib.import_module(module), name)


def main():
    if "--describe" in sys.argv:
        print("\n".join(described()))
        return
    ours = Path(__file__).parents[1] / "recorded_types"
    lines = [
        subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}\n{code()}"],
            capture_output=True, text=True, check=True,
        ).stdout
        for path in ([str(ours)], [])
    ]  # fmt: skip
    if lines[0] != lines[1]:
        sys.exit(f"ours:\n{lines[0]}\nLeRobot's:\n{lines[1]}")


def code():
    folder = str(Path(__file__).parent)
    return (
        f"sys.path.append({folder!r})\nsys.argv.append('--describe')\n"
        "import compare_types\ncompare_types.main()"
    )


if __name__ == "__main__":
    main()
