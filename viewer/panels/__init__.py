"""The panels and tabs around the scene; may import page, scene, server, view_model, the package."""
