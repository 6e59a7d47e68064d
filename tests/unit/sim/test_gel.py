"""The gel against closed forms: Hertz, Cattaneo and Mindlin, the layer; and its bodies."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp, trapezoid

from spikingtac.errors import SpikingTacError
from spikingtac.sim import gel_contact
from spikingtac.sim.gel import Gel, GelConfig
from spikingtac.sim.indenters import INDENTERS, Ellipsoid, Indenter, IndenterConfig, make_indenter
from spikingtac.sim.layer import GridConfig, LayerOperator, MarkerInterpolation, layer_response
from spikingtac.sim.motions import rotation_about
from spikingtac.sim.optics import SkinState
from spikingtac.types import Pose

MARKERS = np.array([[0.0, 0.0], [0.8, 0.3], [2.5, 0.0], [4.0, 1.0], [-5.0, 6.0]])
DT_S = 0.004
AT_ONCE_S = 1e-6  # A step in which nothing creeps.

THICK_RADIUS_MM = 10.0
THICK_GRID = GridConfig(cells=256, span_mm=26.0)
THICK_CONTACT_MM = 10 * THICK_GRID.pitch_mm
THICK_GEL = GelConfig(thickness_mm=8 * THICK_CONTACT_MM, grid=THICK_GRID)
MODULUS_MPA = 0.03


def pose(x: float, y: float, depth: float, rotation: np.ndarray | None = None) -> Pose:
    return Pose(np.array([x, y, depth]), np.eye(3) if rotation is None else rotation)


def press(gel: Gel, indenter: Indenter, depth: float, x: float = 0.0) -> SkinState:
    """Press to a depth within 0.2 s and return the last state."""
    *_, last = (gel.step(DT_S, indenter, pose(x, 0.0, depth * k / 50)) for k in range(1, 51))
    return last


def thick_ball() -> tuple[Gel, Ellipsoid, float, float]:
    """Return a gel of 8 contact radii with a ball, its Hertz force (N) and approach (mm)."""
    ball = Ellipsoid(radius_x_mm=THICK_RADIUS_MM, radius_y_mm=THICK_RADIUS_MM)
    force = 16.0 / 3.0 * MODULUS_MPA * THICK_CONTACT_MM**3 / THICK_RADIUS_MM
    approach = THICK_CONTACT_MM**2 / THICK_RADIUS_MM + force * far_compliance()[0]
    return Gel(THICK_GEL, MARKERS), ball, force, approach


def far_compliance() -> tuple[float, float]:
    """Return what the bond at depth h changes at the contact, normal and lateral, mm/N.

    The first term of the difference between layer and half-space under a point force.
    """
    k = np.linspace(1e-6, 60.0 / THICK_GEL.thickness_mm, 100_000)
    normal, _, along, across = layer_response(k, THICK_GEL.thickness_mm)
    normal = trapezoid((normal - 0.5 / k) * k, k)
    lateral = trapezoid(0.5 * (along + across - 1.5 / k) * k, k)
    return normal / (2.0 * np.pi * MODULUS_MPA), lateral / (2.0 * np.pi * MODULUS_MPA)


def body(kind: str, **settings: float) -> Indenter:
    return make_indenter(IndenterConfig(kind=kind, settings=settings))


THICKNESS_MM = 3.0


def surface_response(k: float, h: float, shear: float, pressure: float) -> tuple[float, float]:
    """Solve equilibrium through the thickness by collocation, at unit modulus.

    Frame: z = 0 at the free surface, z = h at the bond, u_x = i U, s_xz = i S, exp(i k x).
    Unknowns U, w (along z), S, s_zz; incompressible: i k u_x + w' = 0.
    """

    def rates(_z: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, w, s, zz = y
        return np.stack([s - k * w, k * u, 4.0 * k**2 * u - k * zz, k * s])

    def ends(top: np.ndarray, bond: np.ndarray) -> np.ndarray:
        # Outward normal -z: traction along x is -s_xz = shear (i.e. -i S), along z -s_zz.
        return np.array([-top[2] - shear, -top[3] - pressure, bond[0], bond[1]])

    z = np.linspace(0.0, h, 200)
    solution = solve_bvp(rates, ends, z, np.zeros((4, len(z))), tol=1e-8, max_nodes=100_000)
    assert solution.success
    return solution.y[0, 0], solution.y[1, 0]


@pytest.mark.parametrize("kh", [0.05, 0.2, 0.5, 1.0, 2.0, 3.5, 5.0])
def test_closed_forms_equal_a_numeric_solution(kh: float) -> None:
    k = kh / THICKNESS_MM
    told_normal, coupling, along, _ = layer_response(np.array([k]), THICKNESS_MM)
    # shear = i S gives u_x = i U: the factor i cancels in the lateral response.
    lateral, normal_by_shear = surface_response(k, THICKNESS_MM, shear=1.0, pressure=0.0)
    lateral_by_pressure, normal = surface_response(k, THICKNESS_MM, shear=0.0, pressure=1.0)
    assert told_normal[0] == pytest.approx(normal, rel=1e-5)
    assert along[0] == pytest.approx(lateral, rel=1e-5)
    # u_x = i U = -i coupling under unit pressure; under traction i the normal is -(-i)(i) coupling.
    assert coupling[0] == pytest.approx(-lateral_by_pressure, rel=1e-5)
    assert coupling[0] == pytest.approx(-normal_by_shear, rel=1e-5)


def test_tables_are_what_the_operator_does() -> None:
    rng = np.random.default_rng(7)
    operator = LayerOperator(GridConfig(cells=16), THICKNESS_MM)
    traction = rng.normal(size=(3, 16, 16))
    xx, xy, yy, zz, xz, yz = operator.tables
    signed = [[xx, xy, xz], [xy, yy, yz], [-xz, -yz, zz]]
    expected = np.zeros_like(traction)
    for out, into, row, column in np.ndindex(3, 3, 16, 16):
        shifted = np.roll(signed[out][into], (row, column), axis=(0, 1))
        expected[out] += traction[into, row, column] * shifted
    np.testing.assert_allclose(operator.displacements(traction), expected, atol=1e-12)


GRID = GridConfig()
POINTS = np.random.default_rng(1).uniform(-12.0, 12.0, (50, 2))


def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(x) * y, np.cos(0.7 * y) + x, np.exp(-0.5 * (x**2 + y**2) / 1.5**2)])


def test_smooth_fields_and_their_gradients() -> None:
    x, y = np.meshgrid(GRID.axis_mm, GRID.axis_mm)
    inside = POINTS[np.abs(POINTS).max(axis=1) < 11.5]
    moved, gradient = MarkerInterpolation(GRID, inside).at_markers(field(x, y))
    px, py = inside.T
    np.testing.assert_allclose(moved.T, field(px, py), rtol=1e-4, atol=1e-4)
    zero, one = np.zeros_like(px), np.ones_like(px)
    expected = [[np.cos(px) * py, np.sin(px)], [one, -0.7 * np.sin(0.7 * py) + zero]]
    np.testing.assert_allclose(gradient, np.transpose(expected, (2, 0, 1)), atol=2e-3)


def test_a_ball_on_a_thick_layer_is_hertz() -> None:
    gel, ball, force, approach = thick_ball()
    state = gel.step(AT_ONCE_S, ball, pose(0.0, 0.0, approach))
    area = (gel.pressure_mpa > 0.0).sum() * THICK_GRID.pitch_mm**2
    peak = 1.5 * force / (np.pi * THICK_CONTACT_MM**2)
    assert state.force_n[2] == pytest.approx(force, rel=0.03)
    assert np.sqrt(area / np.pi) == pytest.approx(THICK_CONTACT_MM, rel=0.03)
    assert gel.pressure_mpa.max() == pytest.approx(peak, rel=0.03)
    x, y = np.meshgrid(THICK_GRID.axis_mm, THICK_GRID.axis_mm)
    share = 1.0 - (x**2 + y**2) / THICK_CONTACT_MM**2
    profile = peak * np.sqrt(np.maximum(share, 0.0))
    assert np.abs(gel.pressure_mpa - profile)[share > 0.2].max() < 0.03 * peak


FRICTION = 0.8


def mindlin_shift_mm(share: float, force: float) -> float:
    """Return the shift at a share of the sliding force (Mindlin 1949; nu = 1/2), bond included."""
    stiff = 9.0 * FRICTION * force / (32.0 * MODULUS_MPA * THICK_CONTACT_MM)
    bond = share * FRICTION * force * far_compliance()[1]
    return stiff * (1.0 - (1.0 - share) ** (2.0 / 3.0)) + bond


def test_partial_slip_of_a_ball_is_cattaneo_mindlin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gel_contact, "KINETIC_RATIO", 1.0)
    gel, ball, force, approach = thick_ball()
    gel.step(AT_ONCE_S, ball, pose(0.0, 0.0, approach))
    pressed = (gel.pressure_mpa > 0.0).sum()
    for share in (0.2, 0.4, 0.6, 0.8, 0.9):
        state = gel.step(AT_ONCE_S, ball, pose(mindlin_shift_mm(share, force), 0.0, approach))
        assert state.force_n[0] == pytest.approx(share * FRICTION * force, rel=0.05)
        assert abs(state.force_n[1]) < 1e-3 * state.force_n[0]
        strength = np.hypot(*gel.contact.traction[:2])
        stuck = (gel.pressure_mpa > 0.0) & (strength < FRICTION * gel.pressure_mpa * (1 - 1e-5))
        expected = pressed * (1.0 - share) ** (2.0 / 3.0)  # area of the stuck disc
        assert stuck.sum() == pytest.approx(expected, rel=0.05, abs=12)


def test_sliding_meets_kinetic_friction_and_starts_above_it() -> None:
    gel = Gel(GelConfig(), MARKERS)
    ball = body("ball")
    press(gel, ball, 0.6, x=-4.0)
    ratios = []
    for step in range(100):
        state = gel.step(DT_S, ball, pose(-4.0 + 0.06 * (step + 1), 0.0, 0.6))
        ratios.append(state.force_n[0] / state.force_n[2])
    assert np.mean(ratios[-50:]) == pytest.approx(0.8 * FRICTION, abs=0.02)
    assert 0.8 * FRICTION < max(ratios) <= FRICTION


PX_PER_MM = 15.5
GLUED = GelConfig(friction=20.0)
NORMAL = np.array([0.0, 0.0, 1.0])


def test_residual_after_unloading_equals_the_prediction() -> None:
    ball, shift = body("ball"), 12.0 / PX_PER_MM
    left: dict[float, np.ndarray] = {}
    for shear in (0.0, shift):
        gel = Gel(GLUED, MARKERS)
        pressed = press(gel, ball, 0.8).marker_mm
        for step in range(1, 6):
            state = gel.step(DT_S, ball, pose(shear * step / 5, 0.0, 0.8))
        sheared = state.marker_mm - pressed
        for _ in range(1245):
            gel.step(DT_S, ball, pose(shear, 0.0, 0.8))
        times = np.diff([0.0, 0.1, 1.0, 2.0, 5.0])
        left[shear] = np.array([gel.step(dt, None, None).marker_mm for dt in times])
    share = (left[shift] - left[0.0])[:, :4, 0] / sheared[:4, 0]
    assert sheared[0, 0] * PX_PER_MM == pytest.approx(12.0, rel=0.01)
    expected = np.array([[0.95], [0.53], [0.45], [0.31]])
    np.testing.assert_allclose(12.0 * share, np.broadcast_to(expected, share.shape), rtol=0.03)


def test_markers_turn_with_a_stuck_patch_however_far() -> None:
    gel, punch = Gel(GLUED, MARKERS), body("punch", radius_mm=4.0)
    pressed = press(gel, punch, 0.5)
    for degree in range(1, 121):
        turn = rotation_about(NORMAL, np.radians(degree))
        state = gel.step(DT_S, punch, pose(0.0, 0.0, 0.5, turn))
    expected = pressed.marker_mm[:3, :2] @ turn[:2, :2].T
    np.testing.assert_allclose(state.marker_mm[:3, :2], expected, atol=0.005)
    np.testing.assert_allclose(state.gradient[1], turn[:2, :2] @ pressed.gradient[1], atol=0.02)
    assert state.torque_n_mm[2] > 1.0


def test_a_contact_beyond_the_solver_is_refused() -> None:
    gel = Gel(GelConfig(), MARKERS)
    with pytest.raises(SpikingTacError, match="press less deeply"):
        gel.step(DT_S, body("punch", radius_mm=12.9), pose(0.0, 0.0, 0.5))


X, Y = np.meshgrid(*[np.linspace(-10.0, 10.0, 401)] * 2)


@pytest.mark.parametrize("kind", list(INDENTERS))
def test_a_turn_about_the_normal_turns_the_shape(kind: str) -> None:
    shape = body(kind)
    turned = shape.heights_mm(X, Y, rotation_about(NORMAL, np.pi / 2))
    # x towards y: clockwise on the page, since y runs downwards.
    near = turned > -0.4
    expected = np.rot90(shape.heights_mm(X, Y, np.eye(3)), -1)
    np.testing.assert_allclose(turned[near], expected[near], atol=1e-6)
