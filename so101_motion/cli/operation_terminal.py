"""Lead a person through any operation in the terminal.

A command has its letter; the first one that is offered has Enter if it has no letter; ``q`` undoes
all. Commands that are due are given by themselves; without a person those are all there are.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from functools import partial

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from so101_motion.cli.terminal import ENTER, Terminal, keys_line, sentence
from so101_motion.common.errors import So101Error
from so101_motion.common.operation import Offer, Operation, Row, View

WIDTH = 32
PRINTED = 100  # columns of a printed table; chosen

_STYLES = {"dim": "dim", "busy": "cyan", "warm": "yellow", "good": "green", "bad": "red"}


class OperationTerminal:
    """An operation in a terminal."""

    def __init__(self, operation: Operation, terminal: Terminal) -> None:
        self._operation, self._terminal = operation, terminal
        said = operation.view.said  # what was said before was heard before
        self._told = said[-1].number if said else 0
        self._mentioned: set[tuple[str, str]] = set()
        self._question = self._failed = ""

    def go(self) -> View:
        """Go through the operation to its end; returns its last view."""
        pressed, terminal = "", self._terminal
        is_begun = not self._operation.view.is_over  # else once more, on a machine
        while not (view := self._tell()).is_over or not is_begun:
            is_begun = is_begun or not view.is_over
            offer = self._chosen(view, pressed)
            if offer is None:
                terminal.show(self._picture())
                pressed = terminal.key(0.1)
                continue
            try:
                self._give(offer)
            except So101Error as error:
                if not (offer.is_look or terminal.is_manned):
                    raise
                if not offer.is_look:
                    self._failed = str(error)
                self._mention(_trouble(self._operation.view) or self._failed, step="trouble")
            pressed = terminal.pressed
        return view

    def give_up(self) -> str:
        """Undo everything; returns how that has left things, for the caller to say."""
        offer = self._operation.view.cancel
        if offer is None:
            return "nothing was changed"
        self._give(offer)
        said = self._operation.view.said
        return said[-1].text.removeprefix("cancelled: ") if said else "nothing was changed"

    # Helpers

    def _chosen(self, view: View, pressed: str) -> Offer | None:
        due = next((o for o in view.offers if o.due_in is not None and o.due_in <= 0.0), None)
        if not self._terminal.is_manned or not pressed:
            return None if due is None or due.why_not else due
        for offer, key in _keys(view):
            if pressed == key:
                self._failed = "" if offer.why_not is None else f"{offer.title}: {offer.why_not}"
                return offer if offer.why_not is None and self._is_sure(offer) else None
        names = ("Enter" if key == ENTER else key for _, key in _keys(view))
        what = f'"{pressed}"' if pressed.isprintable() else "this key"
        self._failed = f"{what} does nothing here; the keys are {', '.join((*names, 'q'))}"
        return None

    def _is_sure(self, offer: Offer) -> bool:
        """Ask the offer's question, if it has one; the same key again answers it."""
        self._question, asked = offer.asks, self._question
        return not offer.asks or asked == offer.asks

    def _give(self, offer: Offer) -> Mapping[str, object]:
        self._question = self._failed = ""
        ask = partial(self._operation.ask, offer.command, **offer.arguments)
        return self._terminal.run(ask, self._picture)

    def _tell(self) -> View:
        view, terminal = self._operation.view, self._terminal
        for said in view.said:
            if said.number > self._told:
                self._told = said.number
                style = "" if said.tone == "dim" else _STYLES[said.tone]
                terminal.say(said.text, style=style, **said.facts)
        self._mention(view.text, step=view.state)
        for row in view.rows:
            if row.mark == "✓":
                self._mention(f"✓ {row.label}: {' '.join((*row.cells, row.text))}", joint=row.label)
        return view

    def _mention(self, text: str, **facts: object) -> None:
        """Print a text once, where there is no picture."""
        if text and (text, str(facts)) not in self._mentioned:
            self._mentioned.add((text, str(facts)))
            self._terminal.mention(text, **facts)

    def _picture(self) -> RenderableType:
        view = self._operation.view
        lines: list[RenderableType] = [Text(), drawn(view), Text()]
        if view.text:
            lines.append(Text(sentence(view.text), style="bold"))
        if trouble := _trouble(view) or self._failed:
            lines.append(Text(trouble, style="red"))
        lines.append(Text(view.doing or view.note, style="dim"))
        lines += [
            Text(f"{offer.title} in {offer.due_in:.0f} s", style="green")
            for offer in view.offers
            if offer.due_in and not offer.is_look and not view.doing
        ]
        if self._question:
            lines.append(Text(sentence(self._question), style="yellow"))
        if self._terminal.is_manned:
            keys = {
                "Enter" if key == ENTER else key: offer.title
                for offer, key in _keys(view)
                if offer.why_not is None and offer.due_in != 0.0 and not view.doing
            }
            quits = "quit" if view.cancel is None else view.cancel.title
            lines.append(keys_line(**keys, q=quits))
        return Group(*lines)


def _keys(view: View) -> list[tuple[Offer, str]]:
    offers = [offer for offer in view.offers if not offer.cancels and not offer.is_look]
    return [(o, o.key or ENTER) for o in offers if o.key or o is offers[0]]


def _trouble(view: View) -> str:
    return f"{view.trouble}; {view.fix}" if view.fix else view.trouble


def drawn(view: View) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1), show_header=bool(view.columns))
    for heading in ("", "", *view.columns):
        table.add_column(heading, header_style="dim")
    count = max((len(row.cells) for row in view.rows), default=0)
    for row in view.rows:
        style = _STYLES[row.tone]
        cells = [Text(cell, style=style) for cell in row.cells]
        cells += [Text()] * (count - len(cells))
        bar = [] if row.bar is None else [bar_of(row, style)]
        text = [Text(row.text, style=style)] if row.text else []
        table.add_row(Text(row.mark, style=style), Text(row.label), *bar, *cells, *text)
    return table


def printed(view: View, *lines: str) -> str:
    """Lines, and then the table of a view, as plain text."""
    console = Console(file=io.StringIO(), width=PRINTED)
    with console.capture() as table:
        console.print(drawn(view))
    return "\n".join((*lines, table.get()))


def bar_of(row: Row, style: str = "") -> Text:
    assert row.bar is not None
    begin, end = (round(share * WIDTH) for share in row.bar)
    cells = ["█" if begin <= place < end else "·" for place in range(WIDTH)]
    if row.at is not None:
        cells[min(round(row.at * WIDTH), WIDTH - 1)] = "●"
    return Text("".join(cells), style=style)
