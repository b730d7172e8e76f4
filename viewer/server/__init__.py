"""The web server of the page; may import page and the package."""
