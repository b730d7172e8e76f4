import json
import logging
import os
from pathlib import Path

import pytest

from so101_motion.viam.models import module
from so101_motion.viam.models.registered import MODELS

ROOT = Path(__file__).parents[3]
META = json.loads((ROOT / "meta.json").read_text())


def test_the_published_models_are_the_registered_ones():
    listed = {(model["api"], model["model"]) for model in META["models"]}
    registered = {(str(model.api), str(model.model)) for model in MODELS}

    assert listed == registered
    assert len(META["models"]) == len(MODELS)


def test_our_own_loggers_are_heard_by_viam_server():
    assert module  # importing it is what makes them heard
    assert logging.getLogger("so101_motion").handlers


@pytest.mark.parametrize("key", ["entrypoint", "first_run"])
def test_what_viam_server_runs_is_there_and_executable(key):
    assert os.access(ROOT / META[key], os.X_OK)


def test_the_texts_it_points_to_are_there():
    links = [META["markdown_link"], *(model["markdown_link"] for model in META["models"])]

    assert all((ROOT / link).is_file() for link in links)
