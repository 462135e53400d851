"""A board in Python with every fault that a real one shows."""

import threading
from collections import deque

import numpy as np

from hardware.boards.virtual_board import CountedFrames, VirtualBoard
from hardware.link.board_port import Commands


class FaultyFrames:
    """A `FrameSource` that hangs, restarts, is garbled, or is another board; time goes by meanwhile."""

    def __init__(self, counts, info, step_s=None):
        self._own = self._new = lambda: CountedFrames(counts, info, step_s)
        self.frames, self.began_s = self._new(), 0.0
        self.is_stalled, self.garbage = False, deque()

    @property
    def sent(self):
        return self.frames.sent

    @property
    def due_s(self):
        return 1e9 if self.is_stalled else self.frames.due_s + (self.began_s or 0.0)

    def take(self, now_s):
        if self.began_s is None:  # it has just been reset
            self.began_s = now_s
        wire = self.frames.take(now_s - self.began_s)
        if self.garbage:
            self.sent.pop()
            return self.garbage.popleft()
        return wire

    def obey(self, command):
        answer = self.frames.obey(command)
        return b"" if self.is_stalled else self.garbage[0] if self.garbage else answer

    def become(self, info):
        half = None if info is None else np.full(info.n_crossings, 2 ** (info.bits - 1))
        self._new = self._own if info is None else lambda: CountedFrames(half, info)
        self.reset()

    def reset(self):
        self.frames, self.began_s, self.is_stalled = self._new(), None, False


class FaultyBoard(VirtualBoard):
    """A `VirtualBoard` whose methods make it fail; each has happened when it returns."""

    make_frames = FaultyFrames

    def __init__(self, counts, info, **options):
        self._work = deque()
        super().__init__(counts, info, **options)

    def _turn(self):
        while self._work:
            action, done = self._work.popleft()
            action()
            done.set()
        super()._turn()

    def do(self, action):
        """Have the board's thread do something, and wait until it has."""
        done = threading.Event()
        self._work.append((action, done))
        assert done.wait(30), "the board's thread has ended"

    def stall(self, is_so=True):
        """Hang: nothing is sent, nothing is answered, scans are missed; the clock runs on."""
        self.do(lambda: setattr(self.frames, "is_stalled", is_so))

    def unplug(self):
        """Take the port away. The board runs on, and its frames are lost."""
        self.do(self._disconnect)

    def replug(self):
        """Bring a port back after `unplug`: another one, to which the link points."""
        self.do(self._connect)

    def restart(self):
        """Begin again from sequence 0, time 0 and the board's own rate, as after a reset; that also ends a stall."""
        self.do(lambda: self._reset(self.frames.reset))

    def garble(self, garbage, n_frames=1):
        """Send these bytes in the place of each of the next frames, and of answers meanwhile."""
        self.do(lambda: self.frames.garbage.extend([garbage] * n_frames))

    def impostor(self, info):
        """Be another device, which starts anew, all its counts half scale; None: be oneself again."""
        self.do(lambda: self._reset(lambda: self.frames.become(info)))

    def _reset(self, how):
        self._board._commands = Commands()
        how()
