"""The wild policy's configuration; LeRobot finds the other modules by its file name."""

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig


@PreTrainedConfig.register_subclass("wild")
@dataclass
class WildConfig(PreTrainedConfig):
    chunk_size: int = 30
    late_s: float = 0.0  # how long each chunk takes
    is_garbage: bool = False
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(
            ("VISUAL", "STATE", "ACTION"), NormalizationMode.IDENTITY
        )
    )

    def validate_features(self):
        pass

    def get_optimizer_preset(self):
        raise NotImplementedError("it cannot learn")

    def get_scheduler_preset(self):
        return None

    @property
    def observation_delta_indices(self):
        return None

    @property
    def action_delta_indices(self):
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self):
        return None
