import numpy as np
import pytest

from twin.kernel.compiled import native
from twin.kernel.cosim.native import step_function


def test_a_step_is_compiled_once_and_only_when_its_address_is_asked_for(monkeypatch: pytest.MonkeyPatch):
    compiled = []

    def counted(self: native.Native) -> int:
        compiled.append(self.takes)
        return 17

    monkeypatch.setattr(native.Native, "name", "")
    monkeypatch.setattr(native.Native, "_of_numba", counted)
    step = step_function(np.dtype([("x", "f8")]))(lambda m, t, h, u, y: 0)
    assert not compiled
    assert (step.address, step.address) == (17, 17)
    assert len(compiled) == 1
