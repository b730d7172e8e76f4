"""The Share tab: download the plan or the last run as a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from concurrent.futures import Future
from datetime import datetime

import viser

from so101_motion.common.geometry import SE3
from so101_motion.files.trajectory_export import encoded

from ..page import markup, texts
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..view_model import ViewModel
from .film import Film, MovedArm, recording

FILM = "Film for any browser (HTML)"
KINDS = {
    FILM: ".html",
    "Table, degrees (CSV)": ".csv",
    "JSON, degrees": ".json",
    "MCAP: Foxglove, Rerun": ".mcap",
}
"""Kinds of files and their endings."""

PLAN, RUN = "The plan", "The last run"

NOTHING = Sentence("Nothing to share yet: plan a motion on the Move tab first.")
READY = "Choose a file type. The file goes to this browser's downloads."


def file_name(arm: MovedArm, kind: str, now: datetime, *, chosen: str = "") -> str:
    """A file name with the local time and the content, so that names sort by time.

    ``chosen`` is the name of the arm, or empty; a film has no arm in its name.
    """
    what = "plan" if arm.run is None else "run"
    which = "" if kind == FILM else re.sub(r"\W+", "-", f" {chosen}".rstrip())
    return f"so101-{what}-{now:%Y%m%d-%H%M%S}{which}{KINDS[kind]}"


def content(arm: MovedArm, kind: str) -> bytes:
    """A file of any of ``KINDS`` but a film; ``ConfigError`` if MCAP's package is not installed."""
    motion = arm.view.plan.trajectory if arm.run is None else arm.run
    return encoded(motion, f"motion{KINDS[kind]}")


class SharePart(Part):
    """Offers motions for download; the name of a single arm is empty."""

    def __init__(
        self,
        context: PageContext,
        pages: Mapping[str, ViewModel],
        bases: Mapping[str, SE3],
        *,
        title: str,
    ) -> None:
        self._context, self._title = context, title
        self._pages, self._bases = pages, bases
        self._seen: tuple[object, ...] = ()
        self._is_current = False
        self._orders: list[tuple[viser.ClientHandle, str, Future[bytes]]] = []
        self._status: Sentence | None = None
        gui = context.gui
        with context.tabs.add_tab("Share"):
            self._sentence = gui.add_html("")
            self._what = gui.add_dropdown("Motion", (PLAN, RUN), disabled=True)
            self._kind = gui.add_dropdown("File", tuple(KINDS))
            self._arm = gui.add_dropdown("Of", tuple(pages), visible=False)
            self._download = gui.add_button("Download", icon=viser.Icon.DOWNLOAD, disabled=True)
        context.on_asked(self._download, self._order)
        context.leave_open(self._what, self._kind, self._arm, self._download)

    def refresh(self) -> bool:
        shown = ((each.plan_view, each.ran) for each in self._pages.values())
        before, self._seen = self._seen, (*shown, self._what.value, self._kind.value)
        is_news = before != self._seen
        if is_news:
            self._status = None
        done = [order for order in self._orders if order[-1].done()]
        for order in done:
            self._orders.remove(order)
            self._hand_over(*order)
        is_current, self._is_current = self._is_current, self._has_current_plan()
        return is_news or bool(done) or is_current is not self._is_current

    def show(self) -> None:
        self._download.disabled = not self._moved(PLAN)
        self._what.disabled = not self._moved(RUN)
        self._arm.visible = len(self._pages) > 1 and self._kind.value != FILM
        self._sentence.content = markup.sentence(self._status or self._offer())

    def _has_current_plan(self) -> bool:
        return all(each.plan_is_current for each in self._pages.values())

    def _offer(self) -> Sentence:
        moved = self._moved()
        if not moved:
            return NOTHING
        first = next(iter(moved.values()))
        if first.run is not None:
            return Sentence(f"The last run, of {first.view.name}. {READY}")
        plan = texts.which(first.view.name, is_current=self._has_current_plan())
        return Sentence(f"{plan}. {READY}")

    def _moved(self, what: str = "") -> dict[str, MovedArm]:
        wanted, moved = what or self._what.value, {}
        for name, page in self._pages.items():
            view, run = page.plan_view, None
            if wanted == RUN and page.ran is not None:
                view, run = page.ran[0], page.ran[1].run
            if view is not None and (run is not None or what != RUN):
                moved[name] = MovedArm(view=view, run=run, T_scene_base=self._bases[name])
        return moved

    def _order(self, client: viser.ClientHandle) -> None:
        arms, chosen, kind = self._moved(), self._arm.value, self._kind.value
        if chosen not in arms:
            return
        self._status = Sentence("Making the file …")
        arm = arms[chosen]
        film = Film(title=self._title, arms=arms)
        name = file_name(arm, kind, datetime.now(), chosen=chosen)
        file = self._context.in_background(
            lambda: recording(film) if kind == FILM else content(arm, kind)
        )
        self._orders.append((client, name, file))

    def _hand_over(self, client: viser.ClientHandle, name: str, file: Future[bytes]) -> None:
        error = file.exception()
        if error is not None:
            self._status = texts.ended(error)
            return
        data = file.result()
        client.send_file_download(name, data, save_immediately=True)
        self._status = Sentence(f"{name}, {_size(len(data))}.", Tone.GOOD)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{max(count / 1e3, 0.1):.1f} kB"
