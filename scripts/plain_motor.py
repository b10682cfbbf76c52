"""The plainest slave that pythonfmu can have: a first-order motor. What `bench.py` measures the Python FMU against."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class PlainMotor(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.duty, self.position, self.velocity, self.position_measured = 0.0, 0.0, 0.0, 0.0
        self.c, self.b = 1.2, 3.0
        self.register_variable(Real("duty", causality=Fmi2Causality.input, start=0.0))
        for name in ("position", "velocity", "position_measured"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        for name in ("c", "b"):
            tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
            self.register_variable(Real(name, **tunable))

    def do_step(self, time, length):
        n = max(1, int(length / 0.002 + 0.999999))
        h = length / n
        for _ in range(n):
            self.velocity += h * (self.c * self.duty - self.b * self.velocity)
            self.position += h * self.velocity
        self.position_measured = self.position
        return True
