"""What the machine knows of the space around an arm: its components, stores and cameras."""
