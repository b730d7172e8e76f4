import pytest
from so101_viewer.server.guarded_server import start_guarded


class NotedScene:
    """viser's scene, and what was added to it.

    Attributes:
        nodes: The handles that viser gave, by the names of their nodes.
    """

    def __init__(self, scene):
        self._scene = scene
        self.nodes = {}

    def __getattr__(self, name):
        add = getattr(self._scene, name)

        def noted(node, *args, **settings):
            self.nodes[node] = add(node, *args, **settings)
            return self.nodes[node]

        return noted

    def under(self, root, depth):
        """The nodes so many levels below ``root``, by what is behind it in their names."""
        names = {node: node.removeprefix(f"{root}/") for node in self.nodes if node != root}
        return {
            name: self.nodes[node]
            for node, name in names.items()
            if node.startswith(f"{root}/") and name.count("/") == depth - 1
        }


@pytest.fixture(scope="module")
def scene():
    server = start_guarded(port=0)
    yield NotedScene(server.viser.scene)
    server.close()
