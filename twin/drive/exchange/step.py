"""The step of a model-exchange FMU: inputs, then its equations from t to t + h with every event on the way, outputs."""

from twin.compiled.function import carray
from twin.cosim.native import address_of, doubles_at, step_function
from twin.drive.adapter import get_all
from twin.drive.exchange import cvode, runge_kutta
from twin.drive.exchange.equations import brought
from twin.drive.exchange.events import handled, slack
from twin.drive.exchange.memory import MANY_EVENTS, MEMORY, MOST_EVENTS, OVERFLOW, UNTOUCHED


@step_function(MEMORY)
def step(m, t, h, u, y):
    end = t + h
    jumped = m.fresh != 0
    m.fresh = 0
    given, last = carray(u, m.width), carray(doubles_at(m.last_inputs), m.width)
    for j in range(m.width):
        if given[j] != last[j]:
            last[j] = given[j]
            jumped = True
    # a step that may be repeated has to begin as it will the next time
    if m.final == 0:
        m.restart = 1
    events = 0
    if m.now < m.next_event <= m.now + slack(m.now):
        # the same time, but an FMU may compare
        m.now = m.next_event
        status = brought(m, m.now, m.x)
        if status != 0:
            return status
    if jumped or m.next_event <= m.now:
        status = handled(m, address_of(u), jumped)
        if status != 0:
            return status
    while m.now < end - slack(end):
        happened = m.next_event <= m.now
        if not happened:
            stop = min(end, m.next_event)
            if m.cvode != 0:
                happened, status = cvode.integrated(m, stop)
            else:
                happened, status = runge_kutta.integrated(m, stop)
            if status != 0:
                return status
        if happened:
            events += 1
            if events > MOST_EVENTS:
                return MANY_EVENTS
            status = handled(m, address_of(u), False)
            if status != 0:
                return status
    for array, count in ((m.x, m.size), (m.k_1, m.size), (m.z, m.indicators)):
        if carray(doubles_at(array), count + 1)[count] != UNTOUCHED:
            return OVERFLOW
    return get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))
