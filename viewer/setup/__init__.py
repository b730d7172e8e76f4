"""The Setup tab; may import page, scene, server and the package."""
