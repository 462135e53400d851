"""All contenders, in the order of the table."""

from studies.bench import ours
from studies.bench.contender import Contender
from studies.bench.peers import calculix, ngsolve_peer, scikit_fem

CONTENDERS: list[Contender] = [
    *ours.CONTENDERS,
    *scikit_fem.CONTENDERS,
    *ngsolve_peer.CONTENDERS,
    *calculix.CONTENDERS,
]


def contender(name: str) -> Contender:
    """The contender of that name.

    Raises
    ------
    KeyError
        If there is none; the message names all.
    """
    for one in CONTENDERS:
        if one.name == name:
            return one
    raise KeyError(f"no contender '{name}'; there are {', '.join(one.name for one in CONTENDERS)}")
