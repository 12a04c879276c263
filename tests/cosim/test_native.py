import numpy as np
import pytest

from twin.cosim import native
from twin.cosim.native import step_function


def test_a_step_is_compiled_once_and_only_when_its_address_is_asked_for(monkeypatch: pytest.MonkeyPatch):
    compiled = []

    def counted(signature, **options):
        compiled.append(signature)
        return lambda function: type("Compiled", (), {"address": 17})

    monkeypatch.setattr(native, "cfunc", counted)
    step = step_function(np.dtype([("x", "f8")]))(lambda m, t, h, u, y: 0)
    assert not compiled
    assert (step.address, step.address) == (17, 17)
    assert len(compiled) == 1
