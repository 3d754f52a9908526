"""Systems as data: shipped ones against hand-written simulations, declarations, closure, refusals."""

import numpy as np
import pytest
from oracles_propagation import simulated

import riskplan as rp
from checkers.deviations import product
from checkers.dynamics import System
from checkers.moment_closure import compiled

SHIPPED = {
    "dubins": rp.dynamics.dubins(0.2),
    "dubins_lateral": rp.dynamics.dubins_lateral(0.2),
    "unicycle": rp.dynamics.unicycle(0.2),
    "dubins_3d": rp.dynamics.dubins_3d(0.2),
    "constant_turn": rp.dynamics.constant_turn(0.2, 0.6),
}
STRAIGHT = {"x": "x + dt*v", "y": "y", "v": "v + w"}


@pytest.mark.parametrize("name", SHIPPED)
def test_steps_are_the_nonlinear_system(name):
    system, rng = SHIPPED[name], np.random.default_rng(3)
    draws = {w: rng.normal(0.1, 0.4, (7, 5)) for w in system.noises}
    values = {v: rng.normal(1.0, 1.0, 5) for v in system.variables}
    path = simulated(name, 0.2, values, draws, turn_rate=0.6)
    for t in range(7):
        values = system.step(values, {w: d[t] for w, d in draws.items()})
        assert np.allclose(np.stack([values["x"], values["y"]], axis=-1), path[t + 1], rtol=0, atol=1e-12)


def test_sine_squared_is_reduced_without_changing_the_function():
    phi = 0.7
    value = {"s:a": np.sin(phi), "c:a": 1 - np.cos(phi)}
    p = {(("s:a", 1),): 2.0, (("c:a", 1), ("s:a", 1)): -3.0, (): 0.5}
    cube = product(product(p, p), p)
    assert max(power for m in cube for g, power in m if g == "s:a") == 1

    def at(q):
        return sum(v * np.prod([value[g] ** e for g, e in m]) for m, v in q.items())

    assert at(cube) == pytest.approx(at(p) ** 3, rel=1e-13)


def test_programs_are_compiled_once_for_equal_systems():
    assert compiled(rp.dynamics.dubins(0.1), 4) is compiled(rp.dynamics.dubins(0.1), 4)
    assert compiled(rp.dynamics.dubins(0.1), 4) is not compiled(rp.dynamics.dubins(0.2), 4)


def test_closure_holds_the_moments_of_the_nonredundant_dubins_state():
    # x^a y^b v^c times a wave of degree k, c and k up to what a and b leave of the order
    for order in (2, 4, 8):
        left = [order - m for m in range(order + 1)]
        expected = sum((m + 1) * (r + 1) * (2 * r + 1) for m, r in enumerate(left))
        assert len(compiled(rp.dynamics.dubins(0.1), order).powers) == expected


def test_a_variable_that_no_moment_needs_is_left_out():
    program = compiled(rp.dynamics.dubins_3d(0.1), 2)
    assert not program.powers[:, program.generators.index("d:z")].any()


def test_angles_and_units_are_found():
    system = rp.dynamics.unicycle(0.5)
    assert (system.angles, system.reals) == (("theta",), ("x", "y"))
    assert system.noise_units == {"w_turn": 0.5}


@pytest.mark.parametrize(
    ("updates", "noises", "message"),
    [
        (
            {"x": "x + u*cos(th)", "y": "y", "th": "th + w"},
            ("w",),
            "updates['x']: 'u' is missing: neither a variable nor a noise; known are x, y, th, w, dt, pi",
        ),
        (
            {**STRAIGHT, "v": "v*q", "q": "q + w"},
            ("w",),
            "updates['v']: not closed: E[v] needs E[v q], which needs E[v q q], and so on; "
            "only noises and numbers may multiply a variable in its own rule",
        ),
        (
            {**STRAIGHT, "v": "v*v + w"},
            ("w",),
            "updates['v']: not closed: E[v] needs E[v v], which needs E[v v v], and so on; "
            "only noises and numbers may multiply a variable in its own rule",
        ),
        (
            {"x": "x + cos(th)", "y": "y", "th": "th + turn", "turn": "turn + w"},
            ("w",),
            "updates['th']: not closed: E[exp(i th)] needs E[exp(i th + i turn)], which needs more without end; "
            "an angle may follow from one lasting angle and from noises and numbers",
        ),
        (
            {"x": "x + cos(th)", "y": "y", "th": "2*th"},
            (),
            "updates['th']: not closed: E[exp(i th)] needs E[exp(i th + i th)], which needs more without end; "
            "an angle may follow from one lasting angle and from noises and numbers",
        ),
        (
            {"x": "x + th*cos(th)", "y": "y", "th": "th"},
            (),
            "updates['x']: 'th' is an angle and may stand inside cos and sin only",
        ),
        (
            {"x": "x + cos(0.5*th)", "y": "y", "th": "th"},
            (),
            "updates['x']: expected whole multiples of the angle 'th', got 0.5",
        ),
        (
            {"x": "x + cos(th*w)", "y": "y", "th": "th"},
            ("w",),
            "updates['x']: 'cos(th * w)': expected an angle to be a sum of multiples of names, "
            "got a product or a power",
        ),
        (
            {"x": "x + tan(th)", "y": "y", "th": "th"},
            (),
            "updates['x']: expected sums and products of names, numbers, cos and sin, got 'tan(th)'",
        ),
        (
            {"x": "x / y", "y": "y"},
            (),
            "updates['x']: expected sums and products of names, numbers, cos and sin, got 'x / y'",
        ),
        ({"x": "x +", "y": "y"}, (), "updates['x']: cannot read 'x +': invalid syntax"),
        ({"x": 1.0, "y": "y"}, (), "updates['x']: expected text such as 'x + dt * v * cos(theta)', got 1.0"),
        ({"x": "x"}, (), "position: expected two of the variables x; got ['x', 'y']"),
        ({"x": "x + cos(y)", "y": "y"}, (), "position: expected real variables, but 'y' is an angle"),
        ({"x": "x", "y": "y", "dt": "dt"}, (), "updates: expected names of variables and noises, not 'dt'"),
        ({"x": "x", "y": "y"}, ("x",), "noises: 'x' is a variable too"),
        ({"x": "x", "y": "y"}, ("w", "w"), "noises: expected different names, got ['w', 'w']"),
        ({"x": "x", "y": "y"}, ([],), "noises: expected names of variables and noises, not []"),
        ((1, 2), (), "updates: expected a mapping from variables to rules, got (1, 2)"),
        (
            {"x": "x + cos(33*th)", "y": "y", "th": "th"},
            (),
            "updates['x']: expected at most 32 times the angle 'th', got 33",
        ),
        (
            {"x": "x" * 100 + "+", "y": "y"},
            (),
            f"updates['x']: cannot read '{'x' * 79}… (103 characters): invalid syntax",
        ),
        ({}, (), "updates: expected a mapping from variables to rules, got {}"),
    ],
)
def test_refusals(updates, noises, message):
    with pytest.raises(rp.InputError) as error:
        System(updates, noises, 0.1)
    assert str(error.value) == message


def test_time_step_must_be_positive():
    with pytest.raises(rp.InputError, match=r"^dt: expected a finite number in \(0, inf\], got 0.0$"):
        rp.dynamics.dubins(0.0)


def test_a_system_that_expands_without_end_is_refused_in_time(monkeypatch):
    monkeypatch.setattr("checkers.moment_closure._MOST_WORK", 300_000)  # at the real limit it takes 10 s
    noises = tuple(f"w{i}" for i in range(10))
    total = "x + " + " + ".join(noises)
    many = System({"x": total, "y": total.replace("x", "y")}, noises, 0.1)
    with pytest.raises(rp.InputError, match="its moments expand to too many terms"):
        compiled(many, 8)
    product = "*".join(f"cos(8*a{i})" for i in range(6))
    wild = System({"x": f"x + {product}", "y": "y"} | {f"a{i}": f"a{i} + w{i}" for i in range(6)}, noises[:6], 0.1)
    with pytest.raises(rp.InputError, match="its rules expand to too many terms"):
        compiled(wild, 2)


def test_rules_are_parsed_not_run():
    with pytest.raises(rp.InputError, match="expected sums and products"):
        System({"x": "__import__('os').getpid()", "y": "y"}, (), 0.1)
    with pytest.raises(rp.InputError, match="expected sums and products"):
        System({"x": "x + 9**9**9", "y": "y"}, (), 0.1)
    with pytest.raises(rp.InputError, match=r"nested too deeply|cannot read"):
        System({"x": "(" * 5000 + "x" + ")" * 5000, "y": "y"}, (), 0.1)
