"""The Program tab; may import page, scene, view_model and the package."""
