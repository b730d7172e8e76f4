"""The Share tab: download the plan or the last run as a file."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import datetime
from operator import is_not

import viser

from so101_motion.common.geometry import SE3
from so101_motion.rig.protocols import RigLike
from so101_motion.tasks.teleop.local_arms import lerobot_of

from ..page import markup, texts
from ..page.page_context import PageContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..view_model import ViewModel
from .film import MovedArm
from .share import FILM, KINDS, PLAN, RUN, SharedMotion, content, file_name, kind_called

NOTHING = Sentence(text="Nothing to share yet: plan a motion first.")
READY = "Choose a file type. The file goes to this browser's downloads."


@dataclass(frozen=True, slots=True, kw_only=True)
class _PendingFile:
    """A file that is being made for a browser."""

    client: viser.ClientHandle
    name: str
    file: Future[bytes]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharingArm:
    """An arm whose motions can be downloaded.

    Attributes:
        rig: The arm.
        page: Has its newest plan and its newest run.
        T_scene_base: Where its base stands in the frame of a scene that it shares with others.
    """

    rig: RigLike
    page: ViewModel
    T_scene_base: SE3 = field(default_factory=SE3.identity)


class SharePart(Part):
    """Offers motions for download.

    Args:
        arms: The arms by name; that of a single one is empty.
    """

    def __init__(self, context: PageContext, arms: Mapping[str, SharingArm], *, title: str) -> None:
        self._context, self._arms, self._title = context, arms, title
        self._seen: tuple[object, ...] = ()
        self._is_current = False
        self._orders: list[_PendingFile] = []
        self._status: Sentence | None = None
        gui = context.gui
        with context.tabs.add_tab("Share"):
            self._sentence = gui.add_html("")
            self._what = gui.add_dropdown("Motion", (PLAN, RUN), disabled=True)
            self._kind = gui.add_dropdown("File", tuple(kind.label for kind in KINDS))
            self._arm = gui.add_dropdown("Of", tuple(arms), visible=False)
            self._download = gui.add_button("Download", icon=viser.Icon.DOWNLOAD, disabled=True)
        context.on_asked(self._download, self._order)
        context.leave_open(self._what, self._kind, self._arm, self._download)

    def refresh(self) -> bool:
        """Note what can be shared, and send the files that are ready."""
        before, self._seen = (
            self._seen,
            (
                *(each.page.plan_view for each in self._arms.values()),
                *(each.page.ran for each in self._arms.values()),
                self._what.value,
                self._kind.value,
            ),
        )
        is_news = len(before) != len(self._seen) or any(map(is_not, self._seen, before))
        if is_news:
            self._status = None
        done = [order for order in self._orders if order.file.done()]
        for order in done:
            self._orders.remove(order)
            self._hand_over(order)
        is_current, self._is_current = self._is_current, self._has_current_plan()
        return is_news or bool(done) or is_current is not self._is_current

    def show(self) -> None:
        """Update the widgets."""
        self._download.disabled = not self._moved(PLAN)
        self._what.disabled = not self._moved(RUN)
        self._arm.visible = len(self._arms) > 1 and kind_called(self._kind.value) is not FILM
        self._sentence.content = markup.sentence(self._status or self._offer())

    def _has_current_plan(self) -> bool:
        return all(each.page.plan_is_current for each in self._arms.values())

    def _offer(self) -> Sentence:
        moved = self._moved()
        if not moved:
            return NOTHING
        first = next(iter(moved.values()))
        if first.run is not None:
            return Sentence(text=f"The last run, of {first.view.name}. {READY}")
        plan = texts.which(first.view.name, is_current=self._has_current_plan())
        return Sentence(text=f"{plan}. {READY}")

    def _moved(self, what: str = "") -> dict[str, MovedArm]:
        """How the arms move in the plan or the last run, by default in what is chosen."""
        wanted, moved = what or self._what.value, {}
        for name, arm in self._arms.items():
            view, run = arm.page.plan_view, None
            if wanted == RUN and arm.page.ran is not None:
                view, run = arm.page.ran[0], arm.page.ran[1].run
            if view is not None and (run is not None or what != RUN):
                moved[name] = MovedArm(view=view, run=run, T_scene_base=arm.T_scene_base)
        return moved

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
        moved, chosen = self._moved(), self._arm.value
        if chosen not in moved:
            return None
        return SharedMotion(
            arms=moved,
            chosen=chosen,
            lerobot=lerobot_of(self._arms[chosen].rig),
            title=self._title,
        )


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{max(count / 1e3, 0.1):.1f} kB"
