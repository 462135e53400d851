"""The stages from a design to a table of decoupling errors, from top to bottom.

design -> CAD -> response -> unit -> datasets -> networks -> table. `unit` compares the response's cell with one unit
meshed by pytetwild and solved by scikit-fem. Every file holds the cache key of what made it; a stage is skipped, and
says so, if its files hold the wanted key.
"""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from common.errors import FileFormatError, GeometryError
from common.storage.files import digest, write_json, write_text
from common.storage.journal import Journal, hashes_of, intact
from common.storage.seal import say_made_anew
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import dataset_cache_key, simulate
from dataset.stored import in_memory, is_current, read_samples
from decoupler.data.columns import component_named
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model_file import model_cache_key, read_network, write_model
from fem.array.response import ArrayResponse
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import check_unit
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.layout import untold
from geometry.mould import write_cad
from tripillar.pipeline.comparison import Comparison, compare
from tripillar.pipeline.manufactured import SETTINGS, as_made
from tripillar.pipeline.stage import Stage, respond
from tripillar.terminal.progress import Bars

CAD_METHOD = 1  #: raise when the same design gives other CAD files
#: protocols of the table, each with the force component that it loads; of a design those that its pillars tell
STUDIED = {"contact-fz": "fz", "contact-fx": "fx", "independent-fz": "fz", "independent-fx": "fx"}
SPLITS = {"train": (2000, 1), "test": (200, 2)}  #: samples and seed, as many as the paper's
CAP = 0.3  #: largest pillar strain, the paper's wider one

#: networks of the table by name
NETWORKS = {
    "skip net from the response (ours)": (NetworkConfig(feature="inverse"), TrainingConfig()),
    "skip net on √R, 36 nodes (ours)": (NetworkConfig(hidden=36, feature="root"), TrainingConfig()),
    "plain 17 (the paper's)": (
        NetworkConfig(hidden=17, net="plain", feature="resistance"),
        TrainingConfig(trainer="lm"),
    ),
}


@dataclass(frozen=True, kw_only=True)
class PipelineResult:
    """The stages that ran and the comparisons of the table."""

    stages: list[Stage]
    comparisons: list[Comparison]

    @property
    def files(self) -> list[Path]:
        """Every file that the stages wrote or found, in order."""
        return [path for stage in self.stages for path in stage.files]

    def as_plain(self) -> dict[str, Any]:
        """The result as dictionaries, lists, strings and numbers, for JSON."""
        stages = [asdict(stage) | {"files": [str(path) for path in stage.files]} for stage in self.stages]
        return {"stages": stages, "comparisons": [asdict(comparison) for comparison in self.comparisons]}


def run_pipeline(design: SensorDesign, out: Path, bars: Bars, until_dataset: bool = False) -> PipelineResult:
    """Run every stage, or stop after the datasets; files go to a folder, meshes and responses into the cache, too."""
    stages = [draw(design, out / "cad", bars)]
    stage, response = respond(design, bars)
    stages.append(stage)
    stages.append(compare_unit(design, bars))
    stages.append(make_datasets(response, out, bars))
    if until_dataset:
        return PipelineResult(stages=stages, comparisons=[])
    stage, models = train_networks(response, out, bars)
    stages.append(stage)
    stage, truth = respond(as_made(design), bars, SETTINGS[design.pad.kind])
    stages.append(replace(stage, name="as made"))
    sensitivities, _, _ = response_sensitivities(design)
    comparisons = []
    for protocol in models:
        paths = (_dataset_path(out, protocol, split) for split in SPLITS)
        training, test = (in_memory(read_samples(path, labels_only=True)) for path in paths)
        comparisons.append(compare(protocol, training, test, models[protocol], response, sensitivities, truth))
    result = PipelineResult(stages=stages, comparisons=comparisons)
    table = out / "table.json"
    write_json(result.as_plain(), table)
    stages.append(Stage(name="table", seconds=0.0, reused=False, files=(table,)))
    return result


def draw(design: SensorDesign, folder: Path, bars: Bars) -> Stage:
    """Write the design, and STEP and STL of the sensor's parts and its mould."""
    advance = bars.begin("CAD", total=1)
    journal, cache_key = Journal(folder), digest("cad", CAD_METHOD, design.unit, design.array)
    made = journal.read("made", partial(intact, folder)) or {}
    reused = made.get("recipe") == cache_key
    files = [folder / name for name in made["files"]] if reused else []
    if not reused:
        files = write_cad(design, folder)
        hashes = hashes_of({path.name: path.read_bytes() for path in files})
        journal.keep("made", {"recipe": cache_key, "files": hashes})
    description = folder / "design.toml"
    write_text(design_to_toml(design), description)
    advance(1, "reused" if reused else f"{len(files)} files")
    return Stage(name="CAD", seconds=bars.seconds(), reused=reused, files=(description, *files))


def compare_unit(design: SensorDesign, bars: Bars) -> Stage:
    """Mesh one unit by pytetwild, solve it by scikit-fem, and say how far the response's cell is from it."""
    advance = bars.begin("unit", total=1)
    files: tuple[Path, ...] = ()
    try:
        unit = check_unit(design, lambda step: advance(0, step))
        files, reused = (unit.file,) if unit.file.exists() else (), unit.reused
        note = (
            f"the response's cell is {100 * unit.difference:.2g} % from one unit by pytetwild and scikit-fem "
            f"({unit.unknowns} unknowns; both estimate {100 * unit.stated:.2g} % in sum)"
        )
    except GeometryError as error:  # grids of boxes solve what is too thin to be meshed
        note, reused = f"not compared with tetrahedra: {error}", False
    advance(1, note)
    return Stage(name="unit", seconds=bars.seconds(), reused=reused, files=files, note=note)


def make_datasets(response: ArrayResponse, out: Path, bars: Bars) -> Stage:
    """Simulate the training and the test samples of every studied protocol."""
    studied = _studied(response.design)
    advance = bars.begin("datasets", total=len(studied) * sum(samples for samples, _ in SPLITS.values()))
    files, reused, made = [], True, 0
    for protocol in studied:
        for split, (samples, seed) in SPLITS.items():
            settings = DatasetSettings(protocol=protocol, samples=samples, seed=seed, cap=CAP)
            path = _dataset_path(out, protocol, split)
            if is_current(path, dataset_cache_key(response, settings)):
                advance(samples, "reused")
            else:
                simulate(response, settings, lambda n: advance(n, "")).write(path)
                reused, made = False, made + samples
            files.append(path)
    note = "" if reused else f"{made} samples"
    return Stage(name="datasets", seconds=bars.seconds(), reused=reused, files=tuple(files), note=note)


def train_networks(response: ArrayResponse, out: Path, bars: Bars) -> tuple[Stage, dict[str, dict[str, Decoupler]]]:
    """Train every network of the table on every studied protocol."""
    models: dict[str, dict[str, Decoupler]] = {}
    files, all_reused = [], True
    studied = _studied(response.design)
    advance = bars.begin("networks", total=len(studied) * len(NETWORKS))
    for protocol, component in studied.items():
        data = in_memory(read_samples(_dataset_path(out, protocol, "train"), labels_only=True))
        models[protocol] = {}
        for name, (network, training) in NETWORKS.items():
            path = out / "models" / f"{protocol}-{network.net}{network.hidden}-{network.feature}.safetensors"
            advance(0, f"{protocol}, {name}")
            model, reused = trained(data, component, network, training, path, response)
            all_reused &= reused
            models[protocol][name] = model
            files.append(path)
            advance(1, "reused" if reused else "")
    stage = Stage(name="networks", seconds=bars.seconds(), reused=all_reused, files=tuple(files))
    return stage, models


def _studied(design: SensorDesign) -> dict[str, str]:
    return {name: each for name, each in STUDIED.items() if not untold(design.unit, component_named(each).axes)}


def trained(
    data: Samples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    path: Path,
    response: ArrayResponse | None,
) -> tuple[Decoupler, bool]:
    """Train and write a network unless `path` holds it already; returns it and whether it did."""
    cache_key = model_cache_key(data, component_named(component).name, network, training, response)
    try:
        model = read_network(path)
        if model.made_from.get("recipe") == cache_key:
            return model, True
    except FileFormatError:
        say_made_anew(path)
    from decoupler import train  # loads torch, which takes seconds: only when something is trained

    model = train(data, component, network, training, response=response)
    write_model(model, path)
    return model, False


def _dataset_path(out: Path, protocol: str, split: str) -> Path:
    return out / "data" / f"{protocol}-{split}.nc"
