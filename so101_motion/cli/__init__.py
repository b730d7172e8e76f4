"""The command line ``so101 …``: parse, call, print; in degrees and millimetres.

Each verb is a function in a module of its own. ``shared.py`` has the options and output that verbs
share, ``sources.py`` the options that choose the arm (``--sim``, ``--port`` or ``--machine``), and
``error_exit.py`` turns errors into messages and exit codes. Results go to stdout, everything else
to stderr. Verbs import heavy libraries themselves, so that ``--help`` and the shell's completion
answer at once.
"""

import sys


def main() -> None:
    """Run ``so101``; Ctrl-C ends it without a traceback while it is still being imported, too."""
    try:
        from so101_motion.cli.verbs import main as so101
    except KeyboardInterrupt:
        sys.exit(130)  # as ``error_exit.py`` has it, which may not have been imported
    so101(prog_name="so101")
