import numpy as np
import pytest

from spikingtac.denoise.infer import NetworkDenoiser
from spikingtac.errors import ConfigError
from spikingtac_paper.training.export import export_network
from stand_ins.denoiser_training import noisy_maps

torch = pytest.importorskip("torch")

from spikingtac_paper.training.architecture import (  # noqa: E402
    NetworkConfig,
    apply_network,
    make_network,
)
from spikingtac_paper.training.state import (  # noqa: E402
    TrainingState,
    load_state,
    save_state,
    save_weights,
)
from spikingtac_paper.training.train import prediction_error  # noqa: E402

CONFIGS = [
    NetworkConfig(widths=(8, 16)),
    NetworkConfig(fold=4, widths=(8, 8)),
    NetworkConfig(widths=(8, 16), kernels=(1, 1), depth=3),
    NetworkConfig(kind="evflownet", fold=1, base=2),
    NetworkConfig(kind="evflownet", fold=2, base=2),
]


def multiply_adds(network, config: NetworkConfig, size: tuple[int, int]) -> int:
    """Count the multiplications of the convolutions for one map of ``(width, height)`` px."""
    counted = 0

    def count(module, _, output) -> None:
        nonlocal counted
        counted += output[0].numel() * module.weight[0].numel()

    hooks = [
        module.register_forward_hook(count)
        for module in network.modules()
        if isinstance(module, torch.nn.Conv2d)
    ]
    with torch.no_grad():
        apply_network(network, torch.zeros(1, 1, size[1], size[0]), config.fold)
    for hook in hooks:
        hook.remove()
    return counted


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_the_exported_graph_is_the_network(config, tmp_path):
    torch.manual_seed(0)
    network = make_network(config).eval()
    save_weights(tmp_path / "weights.safetensors", network, config)
    maps = [state_map[:32, :64] for state_map in noisy_maps(2)]
    plain, _ = export_network(tmp_path / "weights.safetensors", tmp_path, maps)
    given = torch.from_numpy(maps[0])[None, None]
    with torch.no_grad():
        logits = apply_network(network, given, config.fold)
    cleaned = NetworkDenoiser(plain).clean(maps[0])
    assert cleaned.std() > 1e-4
    assert np.abs(cleaned - torch.sigmoid(logits)[0, 0].numpy()).max() < 1e-5


def test_the_published_size_is_twenty_gmac():
    config = NetworkConfig(kind="evflownet", fold=1, base=64)
    with torch.device("meta"):
        network = make_network(config)
        counted = sum(
            np.prod(module.weight.shape) * pixels
            for module, pixels in zip(
                [m for m in network.modules() if isinstance(m, torch.nn.Conv2d)],
                [160**2, 80**2, 40**2, 20**2, *[20**2] * 4, 40**2, 80**2, 160**2, 320**2, 320**2],
                strict=True,
            )
        )
    assert counted / 1e9 == pytest.approx(20.0, rel=0.15)


@pytest.mark.parametrize("depth", [1, 2])
def test_the_lean_size_is_counted(depth):
    config = NetworkConfig(widths=(16, 32), depth=depth)
    fine, coarse = 40 * 40, 20 * 20
    expected = 9 * (
        fine * 64 * 16
        + coarse * 16 * 32
        + depth * coarse * 32 * 32
        + fine * 48 * 16
        + fine * 16 * 64
    )
    expected += fine * 16  # the 1x1 convolution that weighs the evidence
    assert multiply_adds(make_network(config), config, (320, 320)) == expected


def fresh_state(**sizes) -> TrainingState:
    network = make_network(NetworkConfig(**sizes))
    return TrainingState(network, torch.optim.Adam(network.parameters()))


def test_a_wrong_shape_names_both(tmp_path):
    save_state(tmp_path / "state.safetensors", fresh_state(widths=(8, 9), depth=1))
    with pytest.raises(ConfigError, match=r"shape \(9,\).*asks for \(8,\)"):
        load_state(tmp_path / "state.safetensors", fresh_state(widths=(8, 8), depth=1))


def test_an_unknown_tensor_is_named(tmp_path):
    save_state(tmp_path / "state.safetensors", fresh_state(widths=(8, 8), depth=2))
    with pytest.raises(ConfigError, match="has an unknown tensor 'middle"):
        load_state(tmp_path / "state.safetensors", fresh_state(widths=(8, 8), depth=1))


@pytest.mark.parametrize(
    "wrong", [{"fold": 3}, {"widths": (0, 8)}, {"base": 0}, {"kernels": (2, 1)}]
)
def test_unfit_sizes_are_refused(wrong):
    with pytest.raises(ValueError, match=r"valid|positive"):
        NetworkConfig(**wrong)


def test_the_prediction_error_is_least_at_the_expectation():
    random = torch.Generator().manual_seed(0)
    target = (torch.rand(1, 1, 100, 100, generator=random) < 0.3).float()
    losses = {
        level: float(prediction_error(torch.full_like(target, level).logit(), target))
        for level in (0.1, 0.2, 0.3, 0.4, 0.5)
    }
    assert min(losses, key=lambda level: losses[level]) == 0.3
