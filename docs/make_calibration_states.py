"""Write ``docs/calibration-states.md`` from the workflow's table. Run it when the table changes.

python docs/make_calibration_states.py
"""

from __future__ import annotations

from pathlib import Path

from so101_motion.calib.procedure.steps import INSTRUCTIONS, OFFERED, TABLE, Command, State

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


def mermaid() -> str:
    """The table as a state diagram in Mermaid's language.

    Failures that stay in their state are left out. ``abort`` and ``reset`` do the same everywhere,
    so only the one that is offered is drawn.
    """
    lines = ["stateDiagram-v2", f"    [*] --> {State.IDLE.value}"]
    everywhere = (Command.ABORT, Command.RESET)
    for (state, command), leads in TABLE.items():
        if command in everywhere:
            continue
        lines.append(f"    {state.value} --> {leads.then.value}: {command.value}")
        if leads.otherwise is not state:
            lines.append(f"    {state.value} --> {leads.otherwise.value}: {command.value} fails")
    for state in State:
        if state is not State.IDLE:
            command = Command.RESET if state is State.ERROR else Command.ABORT
            lines.append(f"    {state.value} --> {State.IDLE.value}: {command.value}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
