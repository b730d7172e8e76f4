from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from so101_viewer.server.guarded_server import start_guarded


class NotedScene:
    """viser's scene, and what was added to it.

    Attributes:
        nodes: The handles that viser gave, by the names of their nodes.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self.nodes: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        add = getattr(self._scene, name)

        def noted(node: str, *args: Any, **settings: Any) -> Any:
            self.nodes[node] = add(node, *args, **settings)
            return self.nodes[node]

        return noted

    def under(self, root: str, depth: int) -> dict[str, Any]:
        """The nodes so many levels below ``root``, by what is behind it in their names."""
        names = {node: node.removeprefix(f"{root}/") for node in self.nodes if node != root}
        return {
            name: self.nodes[node]
            for node, name in names.items()
            if node.startswith(f"{root}/") and name.count("/") == depth - 1
        }


@pytest.fixture(scope="module")
def scene() -> Iterator[NotedScene]:
    server = start_guarded(port=0)
    yield NotedScene(server.viser.scene)
    server.close()
