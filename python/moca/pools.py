"""Executors of machines beyond this one, for `Sweep.run(out, pool=…)`."""

from __future__ import annotations

import importlib
from concurrent.futures import Executor, Future
from typing import Any, Callable

__all__ = ["RayPool"]


class RayPool(Executor):
    """Tasks on a Ray cluster: `RayPool()` starts Ray on this machine, `RayPool("auto")` joins the cluster of this node.

    Needs `pip install moca[ray]`. Ray makes the tasks of a node that died again elsewhere.
    """

    def __init__(self, address: str | None = None, **options: Any) -> None:
        ray: Any = importlib.import_module("ray")
        self._ray = ray
        if not ray.is_initialized():
            ray.init(address, log_to_driver=False, **options)
        self._call: Any = ray.remote(lambda function, arguments, keywords: function(*arguments, **keywords))

    @property
    def _max_workers(self) -> int:
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **keywords: Any) -> Future[Any]:
        """Hands a call to the cluster."""
        future: Future[Any] = self._call.remote(function, arguments, keywords).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leaves the cluster, or ends the one that this pool started."""
        self._ray.shutdown()
