"""Which page belongs to which step."""

from __future__ import annotations

from .benches import Ports
from .chain import ChainPage
from .configure import ConfigurePage
from .connection import ConnectionPage
from .motors import MotorsPage
from .page import StepPage
from .pose import PosePage
from .record import RecordPage
from .save import SavePage
from .trial import TrialPage
from .workshop import Workshop


def make_pages(shop: Workshop, ports: Ports) -> dict[str, StepPage]:
    """The page of every step of ``so101_motion.workflow``, by the step's name."""
    return {
        "connect": ConnectionPage(shop, ports),
        "motors": MotorsPage(shop),
        "chain": ChainPage(shop),
        "pose": PosePage(shop),
        "record": RecordPage(shop),
        "save": SavePage(shop),
        "test": TrialPage(shop),
        "configure": ConfigurePage(shop),
    }
