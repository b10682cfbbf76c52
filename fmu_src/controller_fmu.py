class Sampled(Axis):  # noqa: F821
    """A controller. It shares the axis' plumbing; the packer puts both texts and `sample` into one module.

    It reads at its own ticks. What it computes from one reading goes out at the next tick, so no output follows
    an input at once, and every master gives the same result.
    """

    def __init__(self, **kwargs):
        Fmi2Slave.__init__(self, **kwargs)  # noqa: F821
        resources = Path(self.resources)  # noqa: F821
        self.face = json.loads((resources / "interface.json").read_text(encoding="utf-8"))  # noqa: F821
        self.modelName = __name__
        release_at_exit(str(resources.parent / "binaries" / "linux64" / f"{__name__}.so"))  # noqa: F821
        lines = (resources / "parameters.txt").read_text(encoding="utf-8").splitlines()
        pairs = (line.split() for line in lines if line and not line.startswith("#"))
        values = {name: float(value) for name, value in pairs}
        self.variables = self.face["variables"]
        references = {variable["name"]: variable["reference"] for variable in self.variables}
        self.v = [values.get(variable["name"], 0.0) for variable in self.variables]
        self.settable = {v["reference"] for v in self.variables if v["causality"] == "parameter"}
        self.starts = []
        self.inputs = [v["reference"] for v in self.variables if v["causality"] == "input"]
        self.output = next(v["reference"] for v in self.variables if v["causality"] == "output")
        self.parameters = [references[name] for name in self.face["parameters"]]
        self.known = [references[name] for name in self.face["known"]]
        self.settings = [references.get(name) for name in self.face["settings"]]
        self.memory = references[self.face["memory"]]
        self.sizes = self.face["sizes"]
        self.ready = False
        self.clock = None
        self.changed = True
        self.begin()

    def begin(self):
        self.elapsed = self.tick = self.pending = 0.0
        self.x, self.m, self.q = ([0.0] * size for size in self.sizes)
        self.y = [0.0] * len(self.x)
        self.v[self.output] = 0.0
        self.take()
        self.show()

    def take(self):
        problem = super().take()
        fixed = self.face["settings"]
        self.g = [fixed[n] if i is None else self.v[i] for n, i in zip(fixed, self.settings)]  # noqa: B905
        if self.m[0]:
            # Parameters changed under way: the torque that the observer has learnt stays on top.
            self.m[1] = self.p[self.face["offset"]]
            self.p[self.face["offset"]] += self.m[2]
        return problem

    def hidden(self):
        return [self.elapsed, self.tick, self.pending, *self.x, *self.m, *self.q]

    def show(self):
        hidden = self.hidden()
        self.v[self.memory : self.memory + len(hidden)] = hidden

    def problem(self, time, length):
        for i in self.inputs:
            if not finite(self.v[i]):  # noqa: F821
                return f"input {self.variables[i]['name']} is {self.v[i]}: set a finite number"
        return super().problem(time, length)

    def move(self, length):
        v, period = self.v, self.face["sample_time"]
        end = self.elapsed + length
        while self.tick * period < end - 1e-6 * period:
            v[self.output] = self.pending
            inputs = [v[i] for i in self.inputs]
            self.pending = sample(  # noqa: F821
                self.x, self.y, self.m, self.q, self.p, self.g, self.k, *inputs
            )
            self.tick += 1.0
        if self.tick * period <= end + 1e-6 * period:
            v[self.output] = self.pending
        self.elapsed = end

    def set_real(self, vrs, values):
        rest = []
        for i, value in zip(vrs, values):  # noqa: B905
            if i in self.inputs:
                self.v[i] = value
            else:
                rest.append((i, value))
        if rest:
            super().set_real(*zip(*rest))  # noqa: B905

    def _set_fmu_state(self, state):
        self.v[:] = state["v"]
        self.ready = state["ready"]
        self.clock = state["clock"]
        self.elapsed, self.tick, self.pending, *rest = self.v[self.memory : self.memory + len(self.hidden())]
        for kept in (self.x, self.m, self.q):
            kept[:], rest = rest[: len(kept)], rest[len(kept) :]
        self.changed = True
