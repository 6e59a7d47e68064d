"""Attach the simulated sensor to an arm of yours, and press a ball into its skin.

Run: python integrations/mujoco/example.py [ARM.xml SITE]

ARM.xml is any MJCF, such as universal_robots_ur5e/ur5e.xml of MuJoCo Menagerie with the site
attachment_site; without one a small arm is made here. The site's z axis points out of the skin.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np
import spikingtac_mujoco as stm

ARM = """<mujoco><option timestep="0.001"/><worldbody><body name="upper" pos="0 0 .3">
<joint axis="0 1 0" stiffness="50" damping="5"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="2"/>
<body pos=".3 0 0"><joint axis="0 1 0" stiffness="20" damping="2"/>
<geom type="capsule" size=".02" fromto="0 0 0 .2 0 0" mass="1"/>
<site name="fingertip" pos=".2 0 -.021" zaxis="0 0 -1"/></body></body></worldbody></mujoco>"""
RADIUS_M, DEPTH_M = 0.008, 0.001


def main() -> None:
    """Press a ball into the skin, drag it sideways, and print what is felt."""
    if len(sys.argv) == 3:
        spec, site = stm.load_spec(sys.argv[1]), sys.argv[2]
    else:
        spec, site = mujoco.MjSpec.from_string(ARM), "fingertip"
    mount = stm.add_sensor(spec, site=site)
    ball = spec.worldbody.add_body(name="ball", mocap=True, pos=(0.0, 0.0, -1.0))
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(RADIUS_M, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sensor = stm.Sensor(model, mount)  # or fidelity="events": the event camera and the tracker
    sensor.reset(data)
    steps = round(0.01 / model.opt.timestep)
    for k in range(100):
        skin = data.site(site)
        depth_m = min(1.0, k / 30) * (RADIUS_M + DEPTH_M) - RADIUS_M  # from above down to DEPTH_M
        aside_m = 0.001 * np.clip((k - 50) / 30, 0.0, 1.0)
        offset = np.array([aside_m, 0.0, RADIUS_M - depth_m])
        data.mocap_pos[0] = skin.xpos + skin.xmat.reshape(3, 3) @ offset
        mujoco.mj_step(model, data, nstep=steps)
        reading = sensor.step(data)
        if k % 10 == 9:
            moved_px = np.linalg.norm(reading.displacement_px, axis=1).max()
            force, slips = np.round(reading.skin.force_n, 2), reading.slipping
            print(f"{data.time:.2f} s: {moved_px:5.2f} px, {force} N, {slips:.0%} slips")


if __name__ == "__main__":
    main()
