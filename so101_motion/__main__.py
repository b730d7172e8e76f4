"""The module's entry point: ``python -m so101_motion SOCKET [--log-level LEVEL] [--tcp-mode]``."""

import asyncio
import os
import sys


def main() -> None:
    """Serve on the socket that viam-server names on the command line."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(
            "usage: python -m so101_motion SOCKET [--log-level LEVEL] [--tcp-mode]\n"
            "This is what viam-server starts. To see the arm move, run: so101 demo"
        )
    # The matrices are 5x5: threads would only cost memory. Read when numpy is loaded, so first.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from so101_motion.models.module import run

    asyncio.run(run())


if __name__ == "__main__":
    main()
