"""The World tab; may import page, scene and the package."""
