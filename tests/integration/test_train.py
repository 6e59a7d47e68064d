import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.denoise.infer import NetworkDenoiser
from spikingtac.events.recording import RecordingWriter
from stand_ins.denoiser_training import SIZE, moving_disc

TINY = """
seed = 3
rounds = {rounds}
steps = 3
batch = 4
crop_px = 32
moments = 3
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of the command over recordings that hold no truth."""
    torch = pytest.importorskip("torch")
    folder = tmp_path_factory.mktemp("train")
    recordings = [str(folder / f"disc-{seed}") for seed in range(2)]
    for seed, name in enumerate(recordings):
        with RecordingWriter(Path(name), SIZE) as writer:
            writer.write(moving_disc(seed).events)
    assert not list(folder.rglob("truth.npz"))
    (folder / "tiny.toml").write_text(TINY.format(rounds=4))
    given = ["--config", str(folder / "tiny.toml"), "-o", str(folder / "run"), "--json"]
    threads, said = torch.get_num_threads(), io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["train", *recordings, *given, "--bootstrap", recordings[0]]) == 0
    torch.set_num_threads(threads)
    return folder, recordings, json.loads(said.getvalue())


def test_the_command_writes_networks_that_run(trained):
    folder, recordings, summary = trained
    assert main(["train", *recordings, "-o", str(folder / "x"), "--device", "gpu"]) == 2
    assert summary["rounds"] == 4
    noisy = (np.random.default_rng(0).random((48, 64)) < 0.2).astype(np.float32)
    for key in ("onnx", "int8"):
        cleaned = NetworkDenoiser(summary[key]).clean(noisy)
        assert cleaned.shape == noisy.shape
        assert cleaned.std() > 0
    lines = (folder / "run" / "log.jsonl").read_text().splitlines()
    assert [json.loads(line)["round"] for line in lines] == [1, 2, 3, 4]
    assert json.loads(lines[-1])["loss"] == pytest.approx(summary["loss"])


def test_the_same_seed_gives_the_same_weights_and_an_interrupted_run_goes_on_to_them(trained):
    torch = pytest.importorskip("torch")
    from safetensors.numpy import load_file

    from spikingtac_paper.training import train as training
    from spikingtac_paper.training.dataset import load_clip, map_after

    folder, recordings, _ = trained
    config = training.load_training_config(str(folder / "tiny.toml"))
    start = map_after(load_clip(recordings[0]))
    clips = [load_clip(path, start) for path in recordings]

    def stop_half_way(share: float) -> None:
        if share >= 0.5:
            raise KeyboardInterrupt

    threads = torch.get_num_threads()
    try:
        with pytest.raises(KeyboardInterrupt):
            training.train(clips, [], config, folder / "again", stop_half_way)
        assert len((folder / "again" / "log.jsonl").read_text().splitlines()) == 2
        training.train(clips, [], config, folder / "again")
    finally:
        torch.set_num_threads(threads)
    one, other = (load_file(folder / run / "weights.safetensors") for run in ("run", "again"))
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert np.allclose(value, other[name], atol=1e-6), name


@pytest.mark.parametrize(
    ("config", "message"),
    [("leen", "did you mean 'lean'"), ("missing.toml", "cannot read 'missing.toml'")],
)
def test_an_unknown_configuration_is_named(tmp_path, capsys, config, message):
    pytest.importorskip("torch")
    assert main(["train", "--config", config, "-o", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err
