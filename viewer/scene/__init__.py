"""The 3D scene; may import page and the package."""
