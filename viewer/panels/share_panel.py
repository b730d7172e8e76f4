"""The Share tab: download the plan or the last run as a file."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime

import viser

from so101_motion.tasks.teleop.local_arms import lerobot_of

from ..page import markup, texts
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..view_model import ViewModel
from .share import KINDS, PLAN, RUN, SharedMotion, content, file_name, kind_called

NOTHING = Sentence(text="Nothing to share yet: plan a motion first.")
READY = "Choose a file type. The file goes to this browser's downloads."


@dataclass(frozen=True, slots=True, kw_only=True)
class _PendingFile:
    """A file that is being made for a browser."""

    client: viser.ClientHandle
    name: str
    file: Future[bytes]


class SharePart(Part):
    """Offers motions for download.

    Args:
        page: Has the newest plan and the newest run.
    """

    def __init__(self, context: ArmContext, page: ViewModel, *, title: str) -> None:
        self._context, self._page, self._title = context, page, title
        self._plan, self._ran, self._is_current = page.plan_view, page.ran, page.plan_is_current
        self._orders: list[_PendingFile] = []
        self._status: Sentence | None = None
        gui = context.gui
        with context.tabs.add_tab("Share"):
            self._sentence = gui.add_html("")
            self._what = gui.add_dropdown("Motion", (PLAN, RUN), disabled=True)
            self._kind = gui.add_dropdown("File", tuple(kind.label for kind in KINDS))
            self._download = gui.add_button("Download", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._shown_what = PLAN
        context.on_asked(self._download, self._order)
        context.leave_open(self._what, self._kind, self._download)

    def refresh(self) -> bool:
        """Note what can be shared, and send the files that are ready."""
        page = self._page
        is_current, self._is_current = self._is_current, page.plan_is_current
        what, self._shown_what = self._shown_what, self._what.value
        news = (
            page.plan_view is not self._plan
            or page.ran is not self._ran
            or what != self._shown_what
        )
        self._plan, self._ran = page.plan_view, page.ran
        if news:
            self._status = None
        done = [order for order in self._orders if order.file.done()]
        for order in done:
            self._orders.remove(order)
            self._hand_over(order)
        return news or bool(done) or is_current is not self._is_current

    def show(self) -> None:
        """Update the widgets."""
        has_plan = self._plan is not None
        self._download.disabled = not has_plan
        self._what.disabled = self._ran is None
        self._sentence.content = markup.sentence(self._status or self._offer())

    def _offer(self) -> Sentence:
        if self._plan is None:
            return NOTHING
        if self._what.value == RUN and self._ran is not None:
            return Sentence(text=f"The last run, of {self._ran[0].name}. {READY}")
        is_old = "" if self._page.plan_is_current else ", which is old"
        return Sentence(text=f"{self._plan.name}{is_old}. {READY}")

    def _order(self, client: viser.ClientHandle) -> None:
        subject = self._subject()
        if subject is None:
            return
        kind = kind_called(self._kind.value)
        self._status = Sentence(text="Making the file …")
        self._orders.append(
            _PendingFile(
                client=client,
                name=file_name(subject, kind, datetime.now()),
                file=self._context.in_background(lambda: content(subject, kind)),
            )
        )

    def _hand_over(self, order: _PendingFile) -> None:
        error = order.file.exception()
        if error is not None:
            self._status = texts.ended(error)
            return
        data = order.file.result()
        order.client.send_file_download(order.name, data, save_immediately=True)
        self._status = Sentence(text=f"{order.name}, {_size(len(data))}.", tone=Tone.GOOD)

    def _subject(self) -> SharedMotion | None:
        rig, run, view = self._context.rig, None, self._plan
        if self._what.value == RUN and self._ran is not None:
            view, run = self._ran[0], self._ran[1].run
        if view is None:
            return None
        return SharedMotion(
            view=view,
            run=run,
            lerobot=lerobot_of(rig),
            title=self._title,
        )


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{max(count / 1e3, 0.1):.1f} kB"
