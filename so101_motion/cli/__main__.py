"""``python -m so101_motion.cli`` is ``so101``."""

from so101_motion.cli import main

main(prog_name="so101")
