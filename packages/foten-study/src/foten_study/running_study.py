"""A study that runs: what its sessions share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from foten.studio.players import Player, RoundRobinRenderer
from foten_study.loading import Study
from foten_study.markers import Markers
from foten_study.store import Store


class RunningStudy:
    """A study with its database, and what plays.

    Args:
        markers: takes what happens in trials.
    """

    def __init__(self, store: Store, study: Study, markers: Markers | None = None) -> None:
        self.store, self.design, self.stimuli, self.output = store, study.design, study.stimuli, study.output
        self.markers = markers
        self.gains = {key: stimulus.gain_db for key, stimulus in store.stimuli().items()}
        self.player: Callable[[float], Player] = (study.output or RoundRobinRenderer()).player
        # One thread: SQLite waits for the disk, which the sound must not.
        self.disk = ThreadPoolExecutor(1, thread_name_prefix="foten-store")

    @property
    def plays_in_page(self) -> bool:
        """Whether pages play, and not a device of this machine."""
        return self.output is None

    async def on_disk(self, work: Callable[[], Any]) -> Any:
        """Result of some work with the database."""
        return await asyncio.get_running_loop().run_in_executor(self.disk, work)
