"""The wild policy's processors: they pass everything on unchanged."""

from lerobot.processor import make_default_pre_post_processors


def make_wild_pre_post_processors(config, dataset_stats=None):
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
