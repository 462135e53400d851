"""Decoders of whatever presses on bare rubber: made from a library of presses, and tested on contacts."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.design import SensorDesign
from tripillar.face.caller import current
from tripillar.face.inputs import SamplesLike, samples_of

if TYPE_CHECKING:
    from decoupler.evaluation.assessment import Assessment
    from decoupler.touch.decoder import TouchDecoder

READ: dict[str, Any] = {"noise": 0.001, "bits": 12}  #: how a sensor is read where data say nothing else


def touch_decoder(design: SensorDesign, out: Path | None) -> "TouchDecoder":
    """A decoder of touches; its library comes from the cache or is made."""
    caller = current()
    from dataset.measurement import ReadingError
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.touch.library import PRESSES, touch_library
    from decoupler.touch.touch_file import write_touch
    from fem.contact.surface import require_bare

    require_bare(design)
    advance = caller.bars.begin("presses", total=PRESSES)
    library, _, reused = touch_library(design, PRESSES, lambda done: advance(done, ""))
    decoder = TouchDecoder(design=design, errors=ReadingError(**READ), library=library)
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
