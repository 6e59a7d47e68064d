import pytest

from spikingtac.sim import catalog
from spikingtac.sim.motions import IndenterMotion
from spikingtac.sim.scene import Scene

CONTRACT = ("bootstrap", "quiet", "loops", "fifty-contacts", *catalog.TRAJECTORIES)


@pytest.fixture(scope="module")
def scenes() -> dict[str, Scene]:
    return {name: catalog.load_scene(name) for name in catalog.scene_names()}


def test_the_named_scenes_are_there_and_say_what_they_are(scenes):
    assert set(CONTRACT) <= set(scenes)
    assert all(scene.about and "\n" not in scene.about for scene in scenes.values())
    assert len({scene.about for scene in scenes.values()}) == len(scenes)


def test_paths_stay_on_the_pad(scenes):
    for name, scene in scenes.items():
        for contact in scene.contacts:
            motion = IndenterMotion(contact.motion)
            times = [index * 0.02 for index in range(int(motion.duration_s / 0.02))]
            reach = max(abs(motion.pose(t).position_mm[:2]).max() for t in times)
            assert reach + scene.variation.place_mm <= 8.5, name
