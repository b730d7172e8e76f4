"""Write an ACT policy with random weights: ``make_policy.py FOLDER DATASET``. It means nothing."""

import sys
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy


def main(folder, dataset):
    torch.manual_seed(3)
    config = ACTConfig(
        input_features={
            "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(6,)),
            "observation.images.front": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 96)),
        },
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(6,))},
        chunk_size=20,
        n_action_steps=20,
        dim_model=64,
        dim_feedforward=64,
        n_heads=2,
        n_encoder_layers=1,
        latent_dim=8,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    policy = ACTPolicy(config)
    stats = LeRobotDataset("somebody/seen", root=dataset).meta.stats
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    for part in (policy, before, after):
        part.save_pretrained(folder)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
