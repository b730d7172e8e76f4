"""Write the configuration for the arms that discovery found, ready to paste."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from so101_motion.setup.discovery import PortReport


def configuration(reports: Iterable[PortReport]) -> dict[str, list[object]]:
    components: list[object] = []
    for report in reports:
        for one in report.suggestions:
            component: dict[str, object] = {
                "name": one.name,
                "api": one.api,
                "model": one.model,
                "attributes": dict(one.attributes),
            }
            if one.frame is not None:
                component["frame"] = dict(one.frame)
            components.append(component)
    return {"components": components, "modules": [*own_module()]}


def own_module() -> list[dict[str, str]]:
    """The "modules" entry of this installation; empty if viam-server cannot start it."""
    start = Path(__file__).resolve().parents[2] / "run.sh"
    if not start.is_file():
        return []
    return [{"type": "local", "name": "so101-motion", "executable_path": str(start)}]
