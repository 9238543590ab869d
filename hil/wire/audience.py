"""The observers of a server: what they say is heard, what they see is handed over, and nobody waits for them."""

import selectors
import time
from collections.abc import Callable

from hil.wire.door import refuse
from hil.wire.kernel import Kernel
from hil.wire.observer import Observer
from hil.wire.participants import Client
from hil.wire.protocol import Closed, ProtocolError

SHOW_S = 0.005
"""Wall time between two times that observers get frames while time runs without a pause: many frames at a time."""


class Audience:
    """Those who are there, in the order in which they came.

    listening: they only listen until they send. started: time has begun, and they are on their bus.
    """

    def __init__(
        self,
        selector: selectors.BaseSelector,
        kernel_of: Callable[[Client], Kernel],
        on_gone: Callable[[Observer], None],
        listening: bool,
    ) -> None:
        self.observers: list[Observer] = []
        self.started = False
        self._selector = selector
        self._kernel_of = kernel_of
        self._on_gone = on_gone
        self._listening = listening
        self._undisturbed = True
        self._lost_by_departed = 0
        self._shown_s = 0.0

    @property
    def deterministic(self) -> bool:
        """Whether nobody has done anything at an instant that the machine chose."""
        return self._undisturbed and not any(observer.spoke for observer in self.observers)

    @property
    def lost_frames(self) -> int:
        """Frames that observers were too slow to take."""
        return self._lost_by_departed + sum(observer.lost for observer in self.observers)

    @property
    def waits(self) -> bool:
        """Whether somebody has not got every frame yet."""
        return any(observer.unsent for observer in self.observers)

    def seat(self, observer: Observer) -> None:
        """Let an observer watch from now on."""
        if self._listening and observer.listen_only is None:
            observer.port.controller.listen_only = True
        if self.started:
            self._kernel_of(observer).adopt(observer.port)
        self.observers.append(observer)
        self._selector.register(observer.connection, selectors.EVENT_READ, lambda: self._hear(observer))
        self._hear(observer, fill=False)  # what came together with HELLO

    def start(self) -> None:
        """Carry out what they asked for before time began."""
        self.started = True
        for observer in list(self.observers):
            early, observer.early = observer.early, []
            try:
                for kind, body in early:
                    observer.obey(kind, body, True)
            except ProtocolError as error:
                self._show_out(observer, error)

    def _hear(self, observer: Observer, fill: bool = True) -> None:
        """Take what an observer sends (fill: and read its socket before); one that sends nonsense is shown out."""
        try:
            if fill:
                observer.connection.fill()
            while (message := observer.connection.next_message()) is not None:
                observer.obey(*message, self.started)
        except BlockingIOError:
            return
        except ProtocolError as error:
            self._show_out(observer, error)
        except Closed:
            self._dismiss(observer)

    def show(self, at_once: bool) -> None:
        """Hand over the frames that are left for them: at once, or when it is time again."""
        now_s = time.monotonic()
        due = at_once or now_s >= self._shown_s + SHOW_S
        if due:
            self._shown_s = now_s
        for observer in list(self.observers):
            observer.publish()
            try:
                if due:
                    observer.flush()
            except Closed:
                self._dismiss(observer)

    def _show_out(self, observer: Observer, error: ProtocolError) -> None:
        refuse(observer.connection, str(error))
        self._dismiss(observer)

    def _dismiss(self, observer: Observer) -> None:
        self._selector.unregister(observer.connection)
        observer.retire()
        observer.close()
        self.observers.remove(observer)
        self._lost_by_departed += observer.lost
        self._undisturbed &= not observer.spoke
        if self.started:
            self._kernel_of(observer).retire(observer.port)
        self._on_gone(observer)
