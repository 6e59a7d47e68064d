"""Fit the law of indentation to drawn contacts on the twin: ``python scripts/fit_indentation_law.py WORK``.

Draws contacts (``spikingtac.experiments.touch.slides``) of several sizes, depths and places on the
twin's gel, without a camera, keeps their skins in the folder WORK, and fits the network of
``spikingtac.touch.indentation.indentation_law``. Needs torch. The contact scenes are not drawn.
"""
from __future__ import annotations
import sys, time
from dataclasses import replace
from pathlib import Path
import numpy as np
from spikingtac.experiments.touch.slides import KINDS, Body, draw_slide
from spikingtac.sim.scene.source import SceneSource
BODIES = (Body("ball", (0.8, 9.0), (0.1, 1.3)), Body("punch", (0.6, 4.5), (0.08, 0.6)), Body("finger", (5.0, 8.5), (0.4, 2.6)))
work = Path(sys.argv[1]); work.mkdir(exist_ok=True, parents=True)
for number in range(int(sys.argv[2]), int(sys.argv[3])):
    path = work / f"skin_{number:04d}.npz"
    if path.exists(): continue
    t0 = time.time()
    rng = np.random.default_rng(500_000 + number)
    slide = draw_slide(rng, bodies=BODIES, kinds=KINDS)
    contact = slide.scene.contacts[0]; m = contact.motion
    x, y = rng.uniform(-6, 6, 2)
    scene = replace(slide.scene, mechanics_hz=100.0, contacts=(replace(contact, motion=replace(m, x_mm=float(x), y_mm=float(y))),))
    try:
        mm, grad = [], []
        for k, (st, im) in enumerate(SceneSource(scene, number).frames()):
            if k % 4 == 0: mm.append(st.marker_mm.astype(np.float32)); grad.append(st.gradient.astype(np.float32))
    except Exception as e:
        print(number, repr(e)[:100]); continue
    np.savez(path, mm=np.array(mm), grad=np.array(grad), about=slide.scene.about)
    print(number, slide.scene.about, len(mm), round(float(np.array(mm)[..., 2].max()), 2), round(time.time() - t0, 2), flush=True)
