"""``so101 sweep``: long computations, on all cores or a cluster. Imports as ``cli``."""
