"""The command line ``so101 …``: parse, call, print; in degrees and millimetres.

Each verb is a function in a module of its own. ``shared.py`` has the options and output that verbs
share, ``sources.py`` the options that choose the arm (``--sim``, ``--port`` or ``--machine``), and
``error_exit.py`` turns errors into messages and exit codes. Results go to stdout, everything else
to stderr. Verbs import heavy libraries themselves, so that ``--help`` and the shell's completion
answer at once.
"""

import os
import sys

from so101_motion.common import interrupts


def main() -> None:
    """Run ``so101``; signals are taken from here on, see ``interrupts``."""
    try:
        interrupts.listen(_end_by_force, _end_in_import)
        from so101_motion.cli.verbs import main as so101

        if interrupts.first():  # an import is not interrupted; then no verb begins
            raise KeyboardInterrupt
        with interrupts.held():  # click prints and exits in its own way; verbs are interrupted
            so101(prog_name="so101")
    except (KeyboardInterrupt, Exception) as error:
        if type(error).__name__ == "RobotFileError":  # raised by what is imported first
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        if not (interrupts.first() or isinstance(error, KeyboardInterrupt)):
            raise
        _tell_end(interrupts.first() or "Ctrl-C")
        sys.exit(130)  # as ``error_exit.py`` has it, which may not have been imported
    finally:
        interrupts.end()


def _tell_end(name: str) -> None:
    print(f"ended by {name}; nothing moved", file=sys.stderr, flush=True)


def _end_in_import(name: str) -> None:
    shared = sys.modules.get("so101_motion.cli.shared")
    if not getattr(shared, "opened", ()):
        sys.stdout.flush()
        _tell_end(name)
        os._exit(130)


def _end_by_force(name: str) -> None:
    sys.stderr.write(
        f"ended by {name}, by force: the program did not end within 10 s."
        " The arm may still move or hold; switch its power off if it moves\n"
    )
    sys.stderr.flush()
