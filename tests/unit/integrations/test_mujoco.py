"""The sensor in MuJoCo: contact forces, friction, the tasks, and what is refused."""

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import spikingtac as st
from stand_ins.known import known

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("gymnasium")
FOLDER = Path(__file__).resolve().parents[3] / "integrations" / "mujoco"

PRESS = """<mujoco>
<option timestep="0.001" integrator="implicitfast" cone="elliptic" impratio="10"/>
<asset><mesh name="block" vertex="-4 -4 -4 4 -4 -4 -4 4 -4 4 4 -4 -4 -4 4 4 -4 4 -4 4 4 4 4 4"
 scale=".001 .001 .001"/></asset>
<default><default class="arm"><geom margin=".001" group="3"/>
<joint limited="true" range="-1 1" frictionloss="3" stiffness="5"/></default></default>
<worldbody><body name="finger" childclass="arm">
<geom size=".01" mass=".5" contype="0" conaffinity="0"/>
<joint name="base" type="slide" axis="0 1 0" damping="1"/>
<frame pos="0 0 .01"><site name="tip" pos="0 0 -.01"/></frame></body>
<body name="body" pos="{aside} 0 {height}"><joint name="x" type="slide" axis="1 0 0" damping="2"/>
<joint name="z" type="slide" axis="0 0 1" damping="2"/>
<geom {geom} mass=".2" friction="{mu}"/></body>
</worldbody><actuator><motor joint="x"/></actuator>
<keyframe><key name="home" qpos=".001 .002 .003"/></keyframe></mujoco>"""
WEIGHT_N = 0.2 * 9.81
SHAPES = {
    "ball": ('type="sphere" size=".01"', 0.0101),
    "standing rod": ('type="capsule" size=".008 .01"', 0.0181),
    "cylinder": ('type="cylinder" size=".01 .012" euler="90 0 0"', 0.0101),
    "block": ('type="box" size=".004 .004 .004"', 0.0041),
    "stone": ('type="ellipsoid" size=".012 .014 .01"', 0.0101),
    "mesh": ('type="mesh" mesh="block"', 0.0041),
}


@pytest.fixture(scope="module")
def module() -> Any:
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module("spikingtac_mujoco")
    sys.path.remove(str(FOLDER))


def pressed(
    module: Any, shape: str, mu: float, force_n: float, fidelity: str = "ideal", aside: float = 0.0
) -> Any:
    """Let a body lie on a skin that looks up, drag it along x, and return its last reading."""
    geom, height = SHAPES[shape]
    spec = mujoco.MjSpec.from_string(PRESS.format(geom=geom, height=height, mu=mu, aside=aside))
    mount = module.add_sensor(spec, site="tip", friction=mu)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sensor = module.Sensor(model, mount, fidelity)
    sensor.reset(data)
    reading = None
    for k in range(120):
        data.ctrl[0] = force_n * min(1.0, max(0.0, (k - 50) / 40))
        mujoco.mj_step(model, data, nstep=10)
        reading = sensor.step(data)
    return reading


@pytest.mark.parametrize("shape", SHAPES)
def test_heights_are_those_of_rays(module: Any, shape: str) -> None:
    from spikingtac_mujoco.shapes import NO_SURFACE_MM, BodyIndenter

    asset = PRESS[PRESS.index("<asset>") : PRESS.index("<worldbody>")]
    body = f'<body name="body" mocap="true"><geom {SHAPES[shape][0]}/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{asset}<worldbody>{body}</worldbody></mujoco>")
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    indenter = BodyIndenter(model, [0], np.full(2, 50.0))
    x, y = rng.uniform(-12.0, 12.0, (2, 300))
    for _ in range(4):
        data.mocap_quat[0] = rng.standard_normal(4)
        mujoco.mj_forward(model, data)
        rotation = data.xmat[1].reshape(3, 3)
        found = indenter.heights_mm(x, y, rotation) - indenter.center_mm(rotation)
        geom = np.zeros(1, np.int32)
        down = [
            mujoco.mj_ray(model, data, (u, v, 1.0), (0.0, 0.0, -1.0), None, 1, -1, geom)
            for u, v in zip(1e-3 * x, 1e-3 * y, strict=True)
        ]
        hit = np.array(down) >= 0.0
        np.testing.assert_allclose(found[hit], 1e3 * (1.0 - np.array(down)[hit]), atol=1e-6)
        assert (found[~hit] < 0.5 * NO_SURFACE_MM).all()


@pytest.mark.parametrize("aside", [0.0, 0.004])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_gel_carries_what_mujoco_presses_and_drags(
    module: Any, shape: str, aside: float
) -> None:
    reading = pressed(module, shape, 0.9, 0.5, aside=aside)
    np.testing.assert_allclose(reading.skin.force_n[[0, 2]], [0.5, WEIGHT_N], rtol=0.05)
    assert reading.true_px[:, 0].mean() > 0.3


def test_a_body_slips_on_the_skin_as_in_mujoco(module: Any) -> None:
    reading = pressed(module, "block", 0.2, 0.45)
    assert reading.slipping == pytest.approx(1.0)
    assert reading.skin.force_n[0] < 0.25 * reading.skin.force_n[2]


TWO = """<mujoco><option timestep="0.001"/><worldbody><site name="tip"/>
<body name="a" mocap="true"><geom {} friction=".9"/></body>
<body name="b" mocap="true"><geom {} friction=".2"/></body></worldbody></mujoco>"""


def drag(module: Any, shape: str, depth_m: float, steps: int = 100) -> list[Any]:
    """Press one body, then another, into the same skin and drag them; return force and load."""
    spec, found = mujoco.MjSpec.from_string(TWO.format(shape, shape)), []
    mount = module.add_sensor(spec, site="tip", friction=0.1)
    model = spec.compile()
    data, wrench = mujoco.MjData(model), np.zeros(6)
    mujoco.mj_forward(model, data)
    sensor = module.Sensor(model, mount, "ideal")
    with pytest.raises(ValueError, match=r"call reset\(data\)"):
        sensor.step(data)
    sensor.reset(data)
    for which in (0, 1):
        for k in range(steps):
            down_m, data.mocap_pos[:] = min(1.0, k / 20) * 2.0 * depth_m - depth_m, (0.0, 0.0, 1.0)
            data.mocap_pos[which] = (3e-5 * min(max(0, k - 40), 60), 0.0, 0.004 - down_m)
            mujoco.mj_step(model, data, nstep=6)
            reading = sensor.step(data)
        load_n = 0.0
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, wrench)
            load_n += wrench[0]
        found.append((reading.skin.force_n, load_n))
    return found


def test_each_body_has_its_own_friction(module: Any) -> None:
    for (force_n, _), mu in zip(drag(module, 'size=".004"', 0.0007), (0.9, 0.2), strict=True):
        assert 0.5 * mu < force_n[0] / force_n[2] <= mu


def test_a_body_that_is_held_aside_stays_on_the_pad(module: Any) -> None:
    for force_n, load_n in drag(module, 'size=".004"', 0.0007, steps=800):
        assert load_n == pytest.approx(force_n[2], rel=0.08)


def test_a_wide_face_is_carried_steadily(module: Any) -> None:
    for force_n, load_n in drag(module, 'type="box" size=".008 .008 .004"', 0.0005):
        assert load_n == pytest.approx(force_n[2], rel=0.08)


def test_markers_err_as_the_tracker_does_on_events(module: Any) -> None:
    errors = {}
    for fidelity in ("markers", "events"):
        reading = pressed(module, "block", 0.9, 0.5, fidelity)
        off = np.linalg.norm(reading.displacement_px - reading.true_px, axis=1)
        errors[fidelity] = off.mean()
    assert 0.02 < errors["markers"] < 0.3
    assert 0.4 < errors["markers"] / errors["events"] < 2.5


def test_keyframes_keep_their_joints(module: Any) -> None:
    spec = mujoco.MjSpec.from_string(PRESS.format(geom=SHAPES["ball"][0], height=1, mu=1, aside=0))
    module.add_sensor(spec, site="tip")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert [data.joint(name).qpos[0] for name in ("base", "x", "z")] == [0.001, 0.002, 0.003]
    assert data.joint("tip_slide_x").qpos[0] == 0.0


def test_a_calibration_gives_the_markers(module: Any) -> None:
    place = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2) * 30.0
    calibration = known(place + 100.0, grid=(4, 5))
    spec = mujoco.MjSpec.from_string(PRESS.format(geom=SHAPES["ball"][0], height=1, mu=1, aside=0))
    with pytest.raises(st.ConfigError, match="no scale"):
        module.add_sensor(spec, site="tip", calibration=calibration)
    mount = module.add_sensor(spec, site="tip", calibration=calibration.with_pitch(2.0))
    np.testing.assert_allclose(mount.pad_mm, [10.0, 8.0], atol=0.01)
    np.testing.assert_allclose(np.ptp(mount.rest_mm, axis=0), [8.0, 6.0], atol=0.01)


def test_what_is_wrong_is_said(module: Any, tmp_path: Path) -> None:
    with pytest.raises(st.ConfigError, match=r"gone\.xml"):
        module.load_spec(tmp_path / "gone.xml")
    (tmp_path / "bad.xml").write_text("<mujoco><nothing/></mujoco>")
    with pytest.raises(st.ConfigError, match="no model"):
        module.load_spec(tmp_path / "bad.xml")
    spec = mujoco.MjSpec.from_string(PRESS.format(geom=SHAPES["ball"][0], height=1, mu=1, aside=0))
    with pytest.raises(st.ConfigError, match=r"no site 'palm'; it has 'tip'"):
        module.add_sensor(spec, site="palm")
    for told, wrong in (
        ("the pad is 40 x 20 mm, valid are 4 to 24", {"pad_mm": (40.0, 20.0)}),
        ("friction is -1, it must be", {"friction": -1.0}),
        ("unknown camera 'tipical'; did you mean 'typical'", {"camera": "tipical"}),
    ):
        with pytest.raises(st.ConfigError, match=told):
            module.add_sensor(spec, site="tip", **wrong)
    bare = spec.compile()
    mount = module.add_sensor(spec, site="tip")
    with pytest.raises(st.ConfigError, match="compile it after add_sensor"):
        module.Sensor(bare, mount)
    with pytest.raises(st.ConfigError, match="valid are markers, events, ideal"):
        module.Sensor(spec.compile(), mount, "photons")
    model = spec.compile()
    data = mujoco.MjData(model)
    sensor = module.Sensor(model, mount)
    sensor.reset(data)
    mujoco.mj_step(model, data, nstep=30)
    with pytest.raises(ValueError, match="30 ms after the sensor's last step"):
        sensor.step(data)


@pytest.mark.parametrize("name", ["PegInHole", "GripWithoutSlip", "StopOnTouch"])
def test_a_task_is_sound_and_repeats_and_is_done_by_touch(module: Any, name: str) -> None:
    import gymnasium
    from gymnasium.utils.env_checker import check_env
    from spikingtac_mujoco.policies import POLICIES, run

    env = gymnasium.make(f"spikingtac/{name}-v0").unwrapped
    check_env(env, skip_render_check=True)
    runs = []
    for _ in range(2):
        observation, _ = env.reset(seed=3)
        for k in range(40):
            observation, reward, *_ = env.step(np.full(env.action_space.shape, np.sin(k)))
        runs.append((observation["touch"], observation["state"], reward))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
    assert runs[0][2] == runs[1][2]
    found = run(env, POLICIES[name]("markers"), 0)
    assert found["success"]
    assert found.get("excess", 0.0) < 2.0


def test_a_peg_that_is_torn_out_ends_the_episode(module: Any) -> None:
    import gymnasium

    env = gymnasium.make("spikingtac/PegInHole-v0").unwrapped
    env.reset(seed=3)
    assert any(env.step(np.array((0.0, 0.2, -0.2)))[2] for _ in range(env.STEPS))


def test_episodes_become_a_data_set(module: Any, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from spikingtac_mujoco.__main__ import export_episodes

    told = export_episodes("StopOnTouch", tmp_path / "set", 1)
    assert told["total_episodes"] == 1
    assert told["features"][-1] == "action"


def test_pictures_are_drawn_or_refused_with_what_is_missing(
    module: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from spikingtac_mujoco import gl
    from spikingtac_mujoco.draw import Camera, skin_image, write_gif

    reading = pressed(module, "ball", 0.9, 0.2)
    image = skin_image(np.mgrid[0:8, 0:8].reshape(2, -1).T * 37.0, reading, ["simulated"])
    assert image.std() > 5.0
    write_gif(tmp_path / "skin.gif", [image, image[::-1]])
    assert (tmp_path / "skin.gif").read_bytes()[:3] == b"GIF"
    monkeypatch.setenv("MUJOCO_GL", gl.OFF)
    with pytest.raises(st.ConfigError, match="libegl1 or libosmesa6"):
        Camera(mujoco.MjModel.from_xml_string("<mujoco/>"))
