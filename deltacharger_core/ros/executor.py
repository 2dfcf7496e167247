# SPDX-License-Identifier: Apache-2.0
"""Executor of a node: one thread for messages and timers, and workers for callbacks that may wait."""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future as Job, ThreadPoolExecutor, wait
from typing import Any, TextIO

from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future, Task

from deltacharger_core import environment, real_time
from deltacharger_core.ros.clock import ANOTHER_CLOCK

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ModuleNotFoundError as missing:
    environment.refuse_ros(missing)

_TURN = 3600.0  # s; without a timeout, `spin` of the PyPI wheels uses a full core and blocks publishers
_WORKERS = 4  # callbacks of one group at once
_LAST = 5.0  # s for running callbacks to end when the node closes
_served = threading.local()


@contextlib.contextmanager
def serving(header: Any) -> Iterator[None]:
    """Remember the header of the request that this thread serves."""
    _served.sent = getattr(header, "source_timestamp", 0)
    try:
        yield
    finally:
        _served.sent = 0


def order_age() -> float:
    """Return the age (s) of the request that this thread serves; 0 if it is unknown, or as of another clock.

    It is by the middleware's stamp of its sending, which every service has, also those of std_srvs: the time of the
    sender's computer, whatever /clock shows.
    """
    sent = getattr(_served, "sent", 0)
    old = real_time.HOST.age(1e-9 * sent)
    return old if sent and 0.0 < old < ANOTHER_CLOCK else 0.0


class Spinner:
    """Executor of one node, until it is closed.

    One thread serves messages, timers, answers and parameters in order; their callbacks **must not wait**. Services and
    goals of a ReentrantCallbackGroup may wait: each group has its own workers, so no group waits for another. Entities
    of a group that cannot execute are ignored until their owner calls `wake`.

    Attributes:
        node: the node.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self._stop: Future[None] = Future()
        self._failure: BaseException | None = None
        self._pools: dict[Any, ThreadPoolExecutor] = {}
        self._jobs: set[Job[None]] = set()
        self._lock = threading.Lock()
        with contextlib.redirect_stderr(sys.__stderr__ or _nowhere()):  # its faulthandler needs a real file
            self._events = EventsExecutor(context=node.context)
        served: Any = _Served(node, self._answer, self.wake)
        self._events.add_node(served)
        executor: Any = self
        node.executor = executor
        self._thread = threading.Thread(target=self._spin, name=f"spin {node.get_name()}", daemon=True)
        self._thread.start()
        atexit.register(self._end)  # a serving thread would abort the process at Python's exit

    def is_alive(self) -> bool:
        """Whether callbacks are still served."""
        return self._thread.is_alive() and not self._stop.done()

    def close(self, *waitables: Any) -> None:
        """Close the node while its callbacks still work, then stop serving and destroy `waitables` and the node.

        Action clients and servers must be destroyed here, not before: if one is gone while its event is queued,
        EventsExecutor drops the last reference to it without the GIL, which ends the process with a segmentation fault.
        """
        try:
            self.stop()
        finally:
            for waitable in waitables:
                waitable.destroy()
            self.node.destroy_node()

    def stop(self) -> None:
        """Close the node while its callbacks still work, then stop serving. The node stays in the graph."""
        try:
            closer = getattr(self.node, "close", None)
            if closer is not None:
                closer()
        finally:
            self._end()
            atexit.unregister(self._end)
            self._events.shutdown(_LAST)
            with self._lock:
                jobs, pools = set(self._jobs), list(self._pools.values())
            wait(jobs, _LAST)
            for pool in pools:
                pool.shutdown(wait=False, cancel_futures=True)

    def wake(self) -> None:
        """Read the node's entities again; rclpy calls it when entities are added or removed."""
        self._events.wake()

    def create_task(self, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Run a callback in a worker; rclpy calls this for each goal."""
        task: Any = Task(callback, args, kwargs, executor=self._events)

        def run() -> None:
            task()
            task.result()
            if not task.done():
                raise TypeError("the callback of a goal may wait, but not await")

        self._submit(None, run)
        return task

    def call_soon(self, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Run a callback, which must not wait, in the serving thread and return the future of its result.

        Goals are sent this way: an answer that arrives before rclpy's `send_goal_async` returns would be lost
        (ros2/rclpy#1123), and the sending thread cannot receive one meanwhile.
        """
        done: Future[Any] = Future()

        def run() -> None:
            try:
                done.set_result(callback(*args, **kwargs))
            except Exception as error:  # the caller gets it, and serving continues
                done.set_exception(error)

        self._events.create_task(run)
        return done

    def add_node(self, node: Node) -> bool:
        """Do nothing: one executor, one node. rclpy calls it."""
        return False

    def remove_node(self, node: Node) -> None:
        """Do nothing, as `add_node`."""

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not self._stop.done():
                self._events.spin_until_future_complete(self._stop, _TURN)
        if self._failure is not None:
            raise self._failure

    def _end(self) -> None:
        """Stop serving, and wait for the current callback."""
        self._halt()
        self._thread.join(_LAST)

    def _halt(self) -> None:
        if not self._stop.done():
            self._stop.set_result(None)

    def _submit(self, group: CallbackGroup | None, work: Callable[..., None], *args: Any) -> None:
        with self._lock:
            if group not in self._pools:
                self._pools[group] = ThreadPoolExecutor(_WORKERS, f"{self.node.get_name()} worker")
            job = self._pools[group].submit(self._run, work, *args)
            self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)

    def _run(self, work: Callable[..., None], *args: Any) -> None:
        """Run a callback in a worker; an exception ends the node, as in the serving thread."""
        try:
            work(*args)
        except BaseException as error:
            if isinstance(error, InvalidHandle) and self._stop.done():
                return  # no client is left
            self._failure = error
            self._halt()

    def _answer(self, service: Any, request: Any, response: Any, header: Any) -> None:
        """Serve a request in a worker of its group."""

        def serve() -> None:
            with serving(header):
                service.send_response(service.callback(request, response), header)

        self._submit(service.callback_group, serve)


class _Served:
    """A node as its executor sees it: without entities that cannot execute, and with non-blocking services."""

    def __init__(self, node: Node, answer: Callable[..., None], look_again: Callable[[], None]) -> None:
        self._node = node
        self._answer = answer
        self._look_again = look_again
        self._deferred: dict[Any, _Deferred] = {}
        self.executor: Any = None
        self.get_logger = node.get_logger

    @property
    def subscriptions(self) -> list[Any]:
        return _executable(self._node.subscriptions)

    @property
    def timers(self) -> list[Any]:
        return _executable(self._node.timers)

    @property
    def clients(self) -> list[Any]:
        return _executable(self._node.clients)

    @property
    def services(self) -> list[Any]:
        services = _executable(self._node.services)
        waiting = [service for service in services if isinstance(service.callback_group, ReentrantCallbackGroup)]
        known = self._deferred
        self._deferred = {each: known.get(each) or _Deferred(each, self._answer) for each in waiting}
        return [self._deferred.get(service, service) for service in services]

    @property
    def waitables(self) -> list[Any]:
        found = []
        for waitable in _executable(self._node.waitables):
            try:
                waitable.get_num_entities()
            except AttributeError:  # an action client joins its node before its constructor is done
                self._look_again()
            else:
                found.append(waitable)
        return found

    @property
    def guards(self) -> list[Any]:
        return list(self._node.guards)


@functools.cache
def _nowhere() -> TextIO:
    return open(os.devnull, "w")


def _executable(entities: Any) -> list[Any]:
    return [entity for entity in entities if entity.callback_group.can_execute(entity)]


class _Deferred:
    """A service whose requests go to a worker.

    An executor asks a service for a response, then sends it. Here the response is the request itself, and sending it
    starts a worker that serves it.
    """

    def __init__(self, service: Any, answer: Callable[..., None]) -> None:
        self._service = service
        self._hand_over = answer
        self.handle = service.handle
        self.srv_type = service.srv_type
        self.callback_group = service.callback_group
        self.callback: Callable[[Any, Any], tuple[Any, Any]] = lambda request, response: (request, response)
        # An attribute, because the executor keeps no reference: a bound method would be gone when called.

    def send_response(self, asked: tuple[Any, Any], header: Any) -> None:
        self._hand_over(self._service, *asked, header)
