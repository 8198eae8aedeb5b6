"""The coil output, written in a thread of its own: a converter that hangs must not keep the others from their work."""

import threading

from mrd_bench_driver.acquisition.backend import AcquisitionError, Backend

# Wall time in s in which the converter must take a voltage. Whoever waits for it delays the samples by as much, and the
# supervisor must hear why before it names these as stale.
WRITE_TIMEOUT = 0.08
_STEP = 0.01


class OutputSilentError(AcquisitionError):
    """The converter has not taken a voltage in time. It may still do so; 0 V follows at once then."""


class OutputWriter:
    """Writes the coil output of a backend. One thread at a time may do so.

    Attributes
    ----------
    silent : bool
        Whether a write has not returned in time, and still has not.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._changed = threading.Condition()
        self._next: float | None = None  # volts that wait to be written
        self._writing = self.silent = False
        self._error: Exception | None = None  # of the latest write
        threading.Thread(target=self._run, name="output", daemon=True).start()

    def write(self, volts: float) -> None:
        """Write a voltage; raise AcquisitionError if the converter refuses it, or OutputSilentError."""
        with self._changed:
            self._next = volts
            self._changed.notify_all()
            # By short steps, because a machine that stands still must not be taken for a converter that does.
            steps = 0 if self.silent else round(WRITE_TIMEOUT / _STEP)
            if not any(self._changed.wait_for(self._is_idle, _STEP) for _ in range(steps)):
                self._next, self.silent = 0.0, True
                raise OutputSilentError(f"the converter's output did not answer within {1e3 * WRITE_TIMEOUT:g} ms; check it")
            if self._error is not None:
                raise self._error

    def _is_idle(self) -> bool:
        return self._next is None and not self._writing

    def _run(self) -> None:
        while True:
            with self._changed:
                while (volts := self._next) is None:
                    self._changed.wait()
                self._next, self._writing = None, True
            error = None
            try:
                self._backend.write(volts)
            except Exception as raised:  # belongs to who has asked for the voltage
                error = raised
            with self._changed:
                self._writing, self._error = False, error
                self.silent = self.silent and self._next is not None
                self._changed.notify_all()
