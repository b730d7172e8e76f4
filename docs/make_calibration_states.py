"""Write ``docs/calibration-states.md`` from the workflow's table. Run it when the table changes.

python docs/make_calibration_states.py
"""

from __future__ import annotations

from pathlib import Path

from so101_motion.calib.procedure.steps import INSTRUCTIONS, OFFERED, State, mermaid

PAGE = Path(__file__).resolve().parent / "calibration-states.md"

_HEAD = """# The states of a calibration

This page is drawn from the table in `so101_motion/calib/procedure/steps.py` by
`docs/make_calibration_states.py`. `abort` and `reset` are possible in every state. A command that
fails where the diagram shows no other way leaves the state as it is and can be given again.

"""


def page() -> str:
    """The page as it should be."""
    rows = [
        f"| `{state.value}` | {INSTRUCTIONS[state]} |"
        f" {', '.join(f'`{command.value}`' for command in OFFERED[state])} |"
        for state in State
    ]
    table = "\n".join(["| State | What to do | Commands |", "|---|---|---|", *rows])
    return f"{_HEAD}```mermaid\n{mermaid()}```\n\n{table}\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
