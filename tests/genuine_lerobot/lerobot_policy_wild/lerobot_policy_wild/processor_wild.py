"""What comes in and goes out stays as it is."""

from lerobot.processor import make_default_pre_post_processors


def make_wild_pre_post_processors(config, dataset_stats=None):
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
