# SPDX-License-Identifier: Apache-2.0
"""rclpy's multi-threaded executor, with less to do between two messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any
from weakref import WeakKeyDictionary, ref

from rclpy.action.client import ActionClient
from rclpy.context import Context
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.executors import (
    ConditionReachedException,
    ExternalShutdownException,
    MultiThreadedExecutor,
    ShutdownException,
    TimeoutException,
)
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities

_MAKING = 1.0  # s that a constructor may take at most


class PatientExecutor(MultiThreadedExecutor):
    """rclpy's multi-threaded executor without its busy loop, and with one look at the node's entities per message.

    While a message waits for its turn, its subscription leaves the wait set but its QoS events stay in it, and with
    Fast DDS the next message wakes those for ever: nothing is ready, and the wait returns at once. Here they leave
    together. Besides, a callback is handed to the workers once rather than at each wake-up, and one that ends because
    the executor was shut down under it is no error.

    The original hands every message to a worker and gathers all entities anew, in Python, once it came, once it was
    taken and once it was dealt with. Here the thread that waits runs the callbacks of messages itself, so **such a
    callback must not wait for another of its node**; services, actions and timers have workers and may. What is waited
    for is what was waited for before, until an entity comes or goes, or while one must stay out of it.
    """

    def __init__(self, num_threads: int, *, context: Context) -> None:
        self._changes = 0  # of the entities
        self._gathered: _Gathered | None = None
        self._with_workers = 0  # callbacks of entities
        self._count_lock = threading.Lock()
        super().__init__(num_threads, context=context)
        if self._guard is not None:
            self._guard.destroy()
        self._guard = _Guard(context)
        self._failure: BaseException | None = None
        # Of each event handler; None where a publisher owns it. Weak at both ends: a subscription keeps its handlers.
        self._subscriptions: WeakKeyDictionary[EventHandler, ref[Any] | None] = WeakKeyDictionary()

    def spin(self) -> None:
        """Serve the node until shutdown, from the thread that calls this."""
        if isinstance(self._guard, _Guard):
            self._guard.looks = threading.get_ident()
        super().spin()

    def wake(self) -> None:
        """Look anew at what there is to wait for, as in the original."""
        self._changes += 1
        super().wake()

    def can_execute(self, entity: Any) -> bool:
        """Return whether the entity may be waited for, as in the original; an event only with its subscription."""
        if isinstance(entity, ActionClient):
            _wait_until_made(entity)
        if not super().can_execute(entity):
            return False
        if not isinstance(entity, EventHandler):
            return True
        if entity not in self._subscriptions:
            self._subscriptions[entity] = self._find_subscription(entity)
        found = self._subscriptions[entity]
        subscription = None if found is None else found()
        return subscription is None or super().can_execute(subscription)

    def _find_subscription(self, handler: EventHandler) -> ref[Any] | None:
        for node in self.get_nodes():
            for subscription in node.subscriptions:
                if handler in subscription.event_handlers:
                    return ref(subscription)
        return None

    def _wait_for_ready_callbacks(
        self, timeout_sec: Any = None, nodes: Any = None, condition: Callable[[], bool] = lambda: False
    ) -> Generator[Any, None, None]:
        """Yield callbacks that are ready, as in the original, which does it where something is under way."""
        if condition():
            raise ConditionReachedException
        ready = None
        if timeout_sec is None and nodes is None and not self._with_workers and not self._tasks:
            ready = self._wait_as_before()
        if ready is None:
            yield from super()._wait_for_ready_callbacks(timeout_sec, nodes, condition)
            return
        for entity, node, take in ready:
            if entity.callback_group.can_execute(entity):
                yield self._make_handler(entity, node, take), entity, node

    def _wait_as_before(self) -> list[Any] | None:
        """Return what is ready, each with its node and what takes it; None where the original has to find that out."""
        if self._is_shutdown:
            raise ShutdownException
        gathered, changes = self._gathered, self._changes
        try:
            if gathered is None or gathered.changes != changes:
                gathered = self._gathered = _gather(self, changes)
            if not gathered.complete:
                return None
            waitables, *others = gathered.wait()
        except InvalidHandle:  # an entity has been destroyed meanwhile
            self._changes += 1
            return None
        if self._is_shutdown:
            raise ShutdownException
        if not self._context.ok():
            raise ExternalShutdownException
        takers: tuple[Any, ...] = (self._take_timer, self._take_subscription, self._take_client, self._take_service)
        ready: list[Any] = [(waitable, node, self._take_waitable) for waitable, node in waitables]
        for take, entities in zip(takers, others, strict=True):
            ready += [(entity, node, take) for entity, node in entities]
        return ready

    def _spin_once_impl(self, timeout_sec: Any = None, wait_condition: Callable[[], bool] = lambda: False) -> None:
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        try:
            offered = self.wait_for_ready_callbacks(timeout_sec, None, wait_condition)
        except (ConditionReachedException, ExternalShutdownException, ShutdownException, TimeoutException):
            return
        with self._tasks_lock:
            self._tasks = [waiting for waiting in self._tasks if waiting[0] is not offered[0]]
        if isinstance(offered[1], Subscription):
            self._run(offered)
            return
        self._count(offered, 1)
        self._executor.submit(self._carry_out, offered)

    def _carry_out(self, offered: Any) -> None:
        """Run a callback in a worker thread."""
        try:
            self._run(offered)
        finally:
            self._count(offered, -1)

    def _count(self, offered: Any, step: int) -> None:
        if offered[1] is not None:  # a task of its own, such as a goal under way, keeps no entity from being waited for
            with self._count_lock:
                self._with_workers += step

    def _run(self, offered: Any) -> None:
        """Run a callback; what it raises ends `spin`, as in the original."""
        task = offered[0]
        try:
            task()
            if task.done():
                task.result()
                return
        except InvalidHandle as error:  # rclpy signals the guard of an executor that has been shut down meanwhile
            if not self._is_shutdown:
                self._fail(error)
            return
        except BaseException as error:
            self._fail(error)
            return
        with self._tasks_lock:
            self._tasks.append(offered)
        self.wake()

    def _fail(self, error: BaseException) -> None:
        self._failure = error
        self.wake()


def _wait_until_made(client: ActionClient[Any, Any, Any]) -> None:
    """Wait for the last lines of an action client's constructor: rclpy's own puts it into the node before its lock."""
    end = time.monotonic() + _MAKING
    while not hasattr(client, "_lock") and time.monotonic() < end:
        time.sleep(0.0005)


class _Guard(GuardCondition):
    """Wakes the thread that waits; what that thread does itself, it need not be woken for.

    Attributes:
        looks: identity of that thread.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(callback=None, callback_group=None, context=context)
        self.looks = 0

    def trigger(self) -> None:
        if threading.get_ident() != self.looks:
            super().trigger()


class _Gathered:
    """All entities of the nodes, and a wait set that fits them.

    Attributes:
        changes: how often the entities had changed when this was gathered.
        complete: whether it holds all that there is to wait for; where not, the original has to do it.
    """

    def __init__(self, changes: int, complete: bool, kinds: list[list[Any]], guards: list[Any], context: Any) -> None:
        self.changes = changes
        self.complete = complete
        *plain, self._waitables = kinds
        self._by_pointer = [{entity.handle.pointer: (entity, node) for entity, node in kind} for kind in plain]
        timers, subscriptions, clients, services = ([entity.handle for entity, _ in kind] for kind in plain)
        self._handles = (timers, subscriptions, clients, services, [guard.handle for guard in guards])
        entered = [handle for handles in self._handles for handle in handles]
        self._entered = [*entered, *(waitable for waitable, _ in self._waitables), context]
        count = NumberOfEntities(len(subscriptions), len(guards), len(timers), len(clients), len(services))
        for waitable, _ in self._waitables:
            count += waitable.get_num_entities()
        self._set: Any = rclpy_implementation.WaitSet(
            count.num_subscriptions,
            count.num_guard_conditions,
            count.num_timers,
            count.num_clients,
            count.num_services,
            count.num_events,
            context,
        )

    def wait(self) -> list[list[Any]]:
        """Wait, and return waitables, timers, subscriptions, clients and services that are ready, each with its node.

        Raises:
            InvalidHandle: an entity has been destroyed.
        """
        entered = 0
        try:
            for each in self._entered:
                each.__enter__()
                entered += 1
            self._fill()
            self._set.wait(-1)
            return [[pair for pair in self._waitables if pair[0].is_ready(self._set)], *self._ready()]
        finally:
            for each in self._entered[:entered]:
                each.__exit__(None, None, None)

    def _fill(self) -> None:
        wait_set = self._set
        wait_set.clear_entities()
        names = ("timer", "subscription", "client", "service", "guard_condition")
        for name, handles in zip(names, self._handles, strict=True):
            add = getattr(wait_set, f"add_{name}")
            for handle in handles:
                add(handle)
        for waitable, _ in self._waitables:
            waitable.add_to_wait_set(wait_set)

    def _ready(self) -> Iterator[list[Any]]:
        for name, known in zip(("timer", "subscription", "client", "service"), self._by_pointer, strict=True):
            pairs = [known[pointer] for pointer in self._set.get_ready_entities(name) if pointer in known]
            yield [pair for pair in pairs if pair[0].handle.is_timer_ready()] if name == "timer" else pairs


def _gather(executor: PatientExecutor, changes: int) -> _Gathered:
    kinds: list[list[Any]] = [[], [], [], [], []]
    complete = True
    for node in executor.get_nodes():
        there = (node.timers, node.subscriptions, node.clients, node.services, node.waitables)
        for kind, entities in zip(kinds, there, strict=True):
            kind += [(entity, node) for entity in entities if executor.can_execute(entity)]
        complete = complete and not any(True for _ in node.guards)
    guards = [guard for guard in (executor._guard, executor._sigint_gc) if guard is not None]
    return _Gathered(changes, complete and len(guards) == 2, kinds, guards, executor.context.handle)
