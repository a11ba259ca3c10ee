"""The node's services. What computes is done by the worker, between two jobs, while the executor goes on."""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.task import Future
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from svc_ros.core.errors import SvcError
from svc_ros.ros.session import Session

_ENDED = False, "the node was cleaned up or shut down"
_ANSWERED_S = 0.1  # by then the executor has sent the answers that were ready before


class Services:
    """`~/status`, `~/enable`, `~/reset`, `~/verify`, and in loop closure `~/save_graph`: the calls of a session."""

    def __init__(self, node: Node, session: Session) -> None:
        self._node, self._session = node, session
        self._waiting: set[Future] = set()
        self._last_answers: Timer | None = None
        self._is_ended = False
        # A service that waits for the worker must not keep the node's other callbacks waiting.
        waits = ReentrantCallbackGroup()
        self._services = [
            node.create_service(Trigger, "~/status", self._on_status),
            node.create_service(SetBool, "~/enable", self._on_enable),
            node.create_service(Trigger, "~/reset", self._on_reset, callback_group=waits),
            node.create_service(Trigger, "~/verify", self._on_verify, callback_group=waits),
        ]
        if session.has_graph:
            self._services.append(
                node.create_service(Trigger, "~/save_graph", self._on_save_graph, callback_group=waits)
            )

        for service in self._services:
            service.send_response = functools.partial(_send_if_it_lives, service.send_response)

    def destroy(self) -> None:
        """Answer what still waits, and give the services back; if something waits, as soon as it has its answer."""
        self._is_ended = True
        if not self._waiting:
            self.give_back()
            return
        for future in list(self._waiting):
            future.set_result(_ENDED)
        # The executor sends an answer after its callback has ended, and fails if there is no service any more.
        self._waiting.clear()
        self._last_answers = self._node.create_timer(
            _ANSWERED_S, self.give_back, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def are_left(self) -> bool:
        """True if there are services that have not been given back yet."""
        return bool(self._services)

    def give_back(self) -> None:
        """Give the services back now; who still waits for an answer gets none if it is not sent yet."""
        if self._last_answers is not None:
            self._node.destroy_timer(self._last_answers)
            self._last_answers = None
        while self._services:
            self._node.destroy_service(self._services.pop())

    def _on_status(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, json.dumps(self._session.status())
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._session.enable(bool(request.data))
        response.success, response.message = True, "enabled" if self._session.is_enabled else "disabled"
        return response

    async def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._session.forget_inputs("the node was reset")
        return await self._answer(response, self._reset)

    async def _on_verify(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._answer(response, lambda: json.dumps(self._session.judge_again()))

    async def _on_save_graph(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._answer(response, self._save_graph)

    def _reset(self) -> str:
        self._session.reset_engine()
        return "pairing, queue, guesses and everything computed are forgotten"

    def _save_graph(self) -> str:
        path = self._session.write_graph()
        return f"written to {path}" if path else "nothing written: no keyframes with odometry, or graph_file is empty"

    async def _answer(self, response: Trigger.Response, call: Callable[[], str]) -> Trigger.Response:
        """Let the worker call, and answer with what it returns or with the error."""
        response.success, response.message = _ENDED if self._is_ended else await self._on_worker(call)
        return response

    def _on_worker(self, call: Callable[[], str]) -> Any:
        future = Future()
        self._waiting.add(future)

        def run() -> None:
            try:
                answer = True, call()
            except SvcError as error:
                answer = False, str(error)
            except Exception as error:
                self._node.get_logger().error(f"service: {type(error).__name__}: {error}")
                answer = False, f"{type(error).__name__}: {error}"
            self._waiting.discard(future)
            future.set_result(answer)
            if self._node.executor is not None:
                self._node.executor.wake()

        self._session.call_on_worker(run)
        return future


def _send_if_it_lives(send: Callable[..., None], *answer: Any) -> None:
    """Send an answer, unless the service is gone: the executor would end with an exception."""
    with contextlib.suppress(InvalidHandle):
        send(*answer)
