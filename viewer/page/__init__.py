"""What all parts of the page share; may import the package, and of the viewer only itself."""
