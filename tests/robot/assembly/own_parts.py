"""A file of classes that take the place of parts, as a user would write it."""

PARTS = """
class Controller:
    inputs = ("p_B", "J", "p_ref_B")
    outputs = ("omega_ref",)

    def __init__(self, kp=1.5):
        self.kp = kp

    def step(self, t, inputs):
        v = self.kp * (inputs["p_ref_B"] - inputs["p_B"])
        return {"omega_ref": 2.0 * inputs["J"].reshape(3, 3) @ v}


class Still(Controller):
    inputs = ("tau_l",)

    def step(self, t, inputs):
        return {"omega_ref": [0.0, 0.0, 0.0]}


class Breaks(Still):
    def step(self, t, inputs):
        return {"omega_ref": [1 / (0.1 - t) * 0.0] * 3}


class Monitor:
    inputs = ("omega_ref",)
    outputs = ("omega_ref", "tripped", "power")

    def __init__(self, trip_s=9e9):
        self.trip_s = trip_s

    def step(self, t, inputs):
        tripped = t >= self.trip_s
        return {"omega_ref": inputs["omega_ref"] * (not tripped), "tripped": tripped, "power": 1.0}


class Body:
    inputs = ()
    outputs = {"s_B": "mm", "v_s_B": "mm/s"}

    def step(self, t, inputs):
        return {"s_B": [0.0, 0.0, 10.0 * t], "v_s_B": [0.0, 0.0, 10.0]}


class Scale:
    inputs = ("F_ee_B",)
    outputs = ("F_z",)

    def step(self, t, inputs):
        return {"F_z": -inputs["F_ee_B"][2]}


class Estimator:
    inputs = ("count_m", "count_l")
    outputs = ("p_B", "J", "F_ee_B", "tau_l")

    def step(self, t, inputs):
        return {"p_B": [0.0, 0.02, -0.085], "J": [1.0, 0, 0, 0, 1, 0, 0, 0, 1], "F_ee_B": [0.0] * 3, "tau_l": [0.0] * 3}
"""
