"""The Teach tab; may import page, scene, view_model and the package."""
