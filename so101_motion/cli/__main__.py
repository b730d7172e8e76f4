"""Run the command line as ``python -m so101_motion.cli``."""

from so101_motion.cli import main

main()
