"""Start the Viam module: ``python -m so101_motion SOCKET [--log-level LEVEL] [--tcp-mode]``."""

import asyncio
import gc
import os
import sys


def main() -> None:
    """Serve on the socket that viam-server names on the command line."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(
            "usage: python -m so101_motion SOCKET [--log-level LEVEL] [--tcp-mode]\n"
            "This is what viam-server starts. To see the arm move, run: so101 demo"
        )
    # The matrices are 5x5, so threads would only cost memory; numpy reads this when it is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()  # nothing that is imported is garbage, and looking takes a twentieth of the start
    try:
        from so101_motion.viam.models.module import run
    except ImportError as error:
        from so101_motion.common.import_check import explain, sentence

        if explain(error) is None:
            raise
        sys.exit(f"error: {sentence(error)}")
    gc.enable()
    asyncio.run(run())


if __name__ == "__main__":
    main()
