"""Chunks of a wave over the table, late; or of 60 deg jumps, thousands of degrees and NaN."""

import time
from collections import deque

import torch
from lerobot.policies.pretrained import PreTrainedPolicy

from .configuration_wild import WildConfig

READY = (0.0, -40.0, 40.0, 55.0, 0.0, 30.0)
NONSENSE = (float("nan"), float("inf"), -float("inf"), 5000.0, -5000.0)


class WildPolicy(PreTrainedPolicy):
    config_class = WildConfig
    name = "wild"

    def __init__(self, config, **_):
        super().__init__(config)
        self.config = config
        self.weight = torch.nn.Parameter(torch.zeros(1))  # there must be something to save
        self.reset()

    def reset(self):
        self._ahead, self._k = deque(), 0
        self._random = torch.Generator().manual_seed(22)

    def get_optim_params(self):
        return {}

    def forward(self, batch):
        raise NotImplementedError("it cannot learn")

    def supports_rtc(self):
        return True

    def init_rtc_processor(self):
        pass

    def predict_action_chunk(self, batch, inference_delay=0, prev_chunk_left_over=None, **_):
        time.sleep(self.config.late_s)
        n = self.config.chunk_size
        steps = torch.arange(self._k, self._k + n, dtype=torch.float32)
        self._k += n - (0 if prev_chunk_left_over is None else len(prev_chunk_left_over))
        wave = 20.0 * torch.sin(steps / 30.0)
        chunk = torch.tensor(READY) + wave[:, None] * torch.tensor((1.0, 0.5, 0.5, 0.5, 1.0, 0.5))
        if self.config.is_garbage:
            chunk += 60.0 * torch.sign(torch.rand(n, 6, generator=self._random) - 0.5)
            for k in range(0, n, 3):
                wrong = NONSENSE[(self._k + k // 3) % len(NONSENSE)]
                chunk[k, (k // 3) % 6] = wrong
        return chunk[None]

    def select_action(self, batch, **_):
        if not self._ahead:
            self._ahead.extend(self.predict_action_chunk(batch)[0])
        return self._ahead.popleft()[None]
