"""Events of publishers and subscriptions that may be destroyed while an executor with several threads waits for them.

rclpy asks an event for its handle again after it has found it destroyed, and `spin` ends with InvalidHandle: whoever
gave a publisher back on one thread ended the executor on another one.
"""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.waitable import NumberOfEntities, Waitable


class SafeEventCallbacks:
    """Event callbacks as rclpy's publishers and subscriptions take them, with events that may go at any moment."""

    def __init__(self, callbacks: Any) -> None:
        self._callbacks = callbacks

    def create_event_handlers(self, callback_group: Any, handle: Any, topic_name: str) -> list[SafeEvent]:
        """What the wrapped callbacks create, each in a SafeEvent."""
        return [SafeEvent(event) for event in self._callbacks.create_event_handlers(callback_group, handle, topic_name)]


class SafeEvent(Waitable):
    """An event that is not ready, and has nothing to take, once it is destroyed."""

    def __init__(self, event: EventHandler) -> None:
        super().__init__(event.callback_group)
        self._event, self._is_waited_for = event, False

    def __enter__(self) -> None:
        self._event.__enter__()

    def __exit__(self, *exception: object) -> None:
        self._event.__exit__(*exception)

    def get_num_entities(self) -> NumberOfEntities:
        """Room that it needs in a wait set."""
        return self._event.get_num_entities()

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add the event if it is still there; room that was counted for it may stay empty."""
        self._is_waited_for = False
        try:
            self._event.add_to_wait_set(wait_set)
        except InvalidHandle:
            return
        self._is_waited_for = True

    def is_ready(self, wait_set: Any) -> bool:
        """True if it happened."""
        return self._is_waited_for and self._event.is_ready(wait_set)

    def take_data(self) -> Any:
        """What happened; None if it was destroyed before somebody asked."""
        try:
            return self._event.take_data()
        except InvalidHandle:
            return None

    async def execute(self, taken_data: Any) -> None:
        """Tell the callback what happened."""
        await self._event.execute(taken_data)

    def destroy(self) -> None:
        """Give the event back as soon as nobody waits for it."""
        self._event.destroy()
