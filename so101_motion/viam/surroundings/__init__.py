"""Read an arm's surroundings from the machine: its components, stores and cameras."""
