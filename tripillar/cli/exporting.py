"""The command that writes models and data sets for other programs."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from geometry.errors import DesignError
from geometry.storage.files import require_file, write_bytes
from tripillar.terminal.console import (
    JsonOption,
    VerbosityOption,
    answer,
    output_file,
    progress_bars,
    require_other,
    require_suffix,
    spelled,
)

ENDINGS = {"parquet": ".parquet", "csv": ".csv", "card": ".md"}  #: of the forms of a data set


def export(
    data: Annotated[Path | None, typer.Argument(help="Data set (.nc or .zarr) to write as --to says.")] = None,
    to: Annotated[
        Literal["parquet", "csv", "card"] | None,
        typer.Option(help="Form of a data set: a table, or the card that describes it; default: as --out ends."),
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Model file to write as --out ends.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            callback=output_file,
            help="File to write: of a model .onnx, or .h for a header in C; of a data set .parquet, .csv or .md; "
            "default: beside the data set.",
        ),
    ] = None,
    precision: Annotated[
        Literal["float", "double"] | None,
        typer.Option(help="Precision of a model's numbers; default: double in .onnx, float in .h."),
    ] = None,
    licence: Annotated[
        str | None, typer.Option("--license", help="Licence of a data set for its card, such as cc-by-4.0.")
    ] = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Write a model or a data set for other programs: ONNX or C, Parquet or CSV.

    A data set's card says in Markdown what it holds, how it was made and under which licence.
    """
    if (data is None) == (model is None):
        raise DesignError("give a data set or --model FILE, one of them.")
    if model is not None:
        if to is not None or licence is not None:
            raise DesignError("--to and --license are for data sets: the ending of --out says the form of a model.")
        _export_model(model, out, precision, json_)
        return
    assert data is not None
    if precision is not None:
        raise DesignError("--precision is for models: a table has the numbers of its data set.")
    named = [form for form, ending in ENDINGS.items() if out is not None and out.suffix == ending]
    form = to or "".join(named)
    if not form:
        raise DesignError("give --to parquet, csv or card, or --out FILE that ends in .parquet, .csv or .md.")
    if licence is not None and form != "card":
        raise DesignError("--license is written into the card: give --to card.")
    written = out or data.with_suffix(".card.md" if form == "card" else ENDINGS[form])
    require_suffix("--out", out, ENDINGS[form])
    require_file(written)
    require_other(written, data)
    from dataset import read_samples
    from dataset.card import UNSTATED, card_text
    from dataset.table import columns_of, write_table

    samples = read_samples(data)
    result: dict[str, Any] = {"file": str(written), "samples": len(samples), "columns": len(columns_of(samples))}
    with progress_bars(verbosity) as bars:
        if form == "card":
            with spelled(license="--license"):
                write_bytes(written, card_text(samples, data, licence or UNSTATED).encode())
        else:
            advance = bars.begin("export", total=len(samples))
            write_table(samples, written, lambda n: advance(n, ""))
    answer(json_, result, f"{result['samples']} samples, {result['columns']} columns", written)


def _export_model(model: Path, out: Path | None, precision: Literal["float", "double"] | None, as_json: bool) -> None:
    if out is None:
        raise DesignError("a model needs --out FILE that ends in .onnx or .h.")
    require_other(out, model)
    from decoupler.export import export_model
    from decoupler.model.model_file import read_model

    exported = export_model(read_model(model), out, precision)
    checked = f"largest deviation from the model: {exported.deviation or 0:.1e} of full scale ({exported.precision})"
    said = f"not checked: {exported.unchecked}" if exported.deviation is None else checked
    answer(as_json, {"file": str(out), **asdict(exported)}, said, out)
