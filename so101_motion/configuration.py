"""What viam-server is to be told of arms that were found: a configuration, ready to paste."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from so101_motion.port_report import PortReport


def configuration(reports: Iterable[PortReport]) -> dict[str, list[object]]:
    """What viam-server understands: the arms with their frames, and this module."""
    components: list[object] = []
    for report in reports:
        parent = "world"
        for one in report.suggestions:
            component = {
                "name": one.name,
                "api": one.api,
                "model": one.model,
                "attributes": dict(one.attributes),
            }
            if one.api in ("rdk:component:arm", "rdk:component:gripper"):
                component["frame"] = {"parent": parent}
                parent = one.name  # the gripper sits on the arm
            components.append(component)
    return {"components": components, "modules": [*own_module()]}


def own_module() -> list[dict[str, str]]:
    """This installation as a local module; none if it is not one that viam-server can start."""
    start = Path(__file__).resolve().parents[1] / "run.sh"
    if not start.is_file():
        return []
    return [{"type": "local", "name": "so101-motion", "executable_path": str(start)}]
