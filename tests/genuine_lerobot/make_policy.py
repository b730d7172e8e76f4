"""Write an untrained policy to a folder: ``FOLDER act DATASET``, ``FOLDER wave``, ``garbage``."""

import sys
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot_policy_wild.configuration_wild import WildConfig
from lerobot_policy_wild.modeling_wild import WildPolicy

STATE = {"observation.state": PolicyFeature(type=FeatureType.STATE, shape=(6,))}
PICTURE = {"observation.images.front": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 96))}
ACTION = {"action": PolicyFeature(type=FeatureType.ACTION, shape=(6,))}


def act(dataset):
    """An ACT policy with random weights, and what to scale it by."""
    config = ACTConfig(
        input_features={**STATE, **PICTURE},
        output_features=ACTION,
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
    return ACTPolicy(config), LeRobotDataset("somebody/seen", root=dataset).meta.stats


def wild(**settings):
    """A policy that does as it likes."""
    config = WildConfig(input_features=STATE, output_features=ACTION, device="cpu", **settings)
    return WildPolicy(config), None


def main(folder, kind, dataset=None):
    torch.manual_seed(3)
    if kind == "act":
        policy, stats = act(Path(dataset))
    else:
        policy, stats = wild(late_s=0.5) if kind == "wave" else wild(is_garbage=True)
    before, after = make_pre_post_processors(policy.config, dataset_stats=stats)
    for part in (policy, before, after):
        part.save_pretrained(Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
