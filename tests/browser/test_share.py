"""The Share tab: the file that Download saves in the browser."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import Guest
from playwright.sync_api import Download

from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.rig import Rig

pytestmark = pytest.mark.browser


def take(guest: Guest, kind: str = "", motion: str = "") -> Download:
    guest.page.get_by_role("tab", name="Share").click()
    for label, wanted in (("Motion", motion), ("File", kind)):
        if wanted:
            field = guest.fields(label).filter(visible=True).first
            field.click()
            guest.page.get_by_role("option", name=wanted).click()
            guest.until(lambda field=field, wanted=wanted: wanted in field.input_value())
            guest.page.wait_for_timeout(300)  # the page sends one message per panel every 50 ms
    with guest.page.expect_download() as download:
        guest.press("Download")
    guest.until(lambda: guest.says(download.value.suggested_filename))
    guest.page.get_by_role("tab", name="Move").click()  # where the next test begins
    return download.value


def plan(guest: Guest) -> None:
    guest.page.get_by_role("tab", name="Move").click()
    guest.plan()


def test_without_a_plan_there_is_nothing_to_download(opened: Guest) -> None:
    opened.page.get_by_role("tab", name="Share").click(timeout=90_000)  # the first picture is slow
    opened.until(lambda: opened.says("Nothing to share yet"))
    opened.until(lambda: opened.button("Download").is_disabled())
    opened.page.get_by_role("tab", name="Move").click()


def test_the_last_run_is_downloaded_as_wanted_and_as_measured(
    guest: Guest, rig: Rig, tmp_path: Path
) -> None:
    rig.arm.scene = Scene()
    guest.until(lambda: guest.button("Plan").is_enabled())
    plan(guest)
    guest.press("Execute")
    guest.until(lambda: guest.says("Arrived"))
    guest.page.get_by_role("tab", name="Share").click()
    guest.until(lambda: guest.fields("Motion").filter(visible=True).first.is_enabled())
    download = take(guest, "Table, degrees (CSV)", "The last run")
    download.save_as(tmp_path / "run.csv")
    assert download.suggested_filename.startswith("so101-run-")
    rows = list(csv.DictReader((tmp_path / "run.csv").read_text().splitlines()))
    end = np.radians([float(rows[-1][f"{joint}_measured_deg"]) for joint in ARM_JOINTS])
    np.testing.assert_allclose(end, rig.arm.state.q, atol=0.02)
