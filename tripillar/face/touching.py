"""Decoders of whatever presses on bare rubber: made from a library of presses, and tested on contacts."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, SamplesLike, design_of, samples_of

if TYPE_CHECKING:
    from decoupler.evaluation.assessment import Assessment
    from decoupler.touch.decoder import TouchDecoder

READ: dict[str, Any] = {"noise": 0.001, "bits": 12}  #: how a sensor is read where data say nothing else


def touch_decoder(source: DesignLike | None, out: Path | None, shapes: Sequence[File] = ()) -> "TouchDecoder":
    """A decoder of touches, of a design or of a twin's own sensor; its library comes from the cache or is made."""
    caller, design = current(), design_of(source)
    from dataset.measurement import ReadingError
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.touch.library import OWN, PRESSES, touch_library
    from decoupler.touch.morph import Pillars
    from decoupler.touch.touch_file import write_touch
    from decoupler.twin.twin_file import read_twin
    from fem.contact import read_solid
    from fem.contact.surface import require_bare

    require_bare(design)
    solids = [read_solid(Path(shape)) for shape in shapes]
    twin = read_twin(Path(source)) if isinstance(source, Path | str) else None
    pillars = Pillars.designed(design) if twin is None else Pillars.identified(twin.read_decoder())
    made_from = {} if twin is None else {"twin": twin.decoder_hash}
    advance = caller.bars.begin("presses", total=PRESSES + OWN * len(shapes))
    library, _, reused = touch_library(design, PRESSES, lambda done: advance(done, ""), solids)
    decoder = TouchDecoder(
        design=design, errors=ReadingError(**READ), library=library, pillars=pillars, made_from=made_from
    )
    if out is not None:
        write_touch(decoder, out)
    result = {"file": str(out), "presses": len(library.presses.size), "rows": len(library.source), "reused": reused}
    text = f"{result['presses']} presses in {result['rows']} places{', reused' if reused else ''}"
    caller.answer(lambda: result | {"seconds": caller.bars.seconds()}, text, *([] if out is None else [out]))
    return decoder


def assessed_touch(decoder: "TouchDecoder", data: "SamplesLike") -> "dict[str, Assessment]":
    """Errors of a touch decoder: of units, of the net force and of its place."""
    caller = current()
    from dataset import in_memory
    from decoupler.touch.assessment import assess_touch
    from tripillar.face.tables import assessed_touch_tables

    samples = in_memory(samples_of(data, labels_only=False))
    advance = caller.bars.begin("touches", total=len(samples))
    found = assess_touch(decoder, samples, lambda done: advance(done, ""))
    caller.answer(found.plain, lambda: assessed_touch_tables(found))
    return found.by_force
