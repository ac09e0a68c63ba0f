"""Cases of a scenario: each is the scenario with some of its keys replaced."""

from __future__ import annotations

from typing import Final, NamedTuple

from taut.base.errors import quoted_list
from taut.scenarios.toml import Section

__all__ = ["OF_A_CASE", "Trial", "cases_of"]

OF_A_CASE: Final = ("arm", "laws", "phases", "control", "plant", "reference", "run", "event")
OF_ALL_CASES: Final = ("title", "outputs", "pass")
MAX_CASES: Final = 200


class Trial(NamedTuple):
    """One run of a scenario: a law in a case."""

    case: str  # empty in a scenario without cases
    law: str

    @property
    def label(self) -> str:
        """What a message calls it."""
        return f"{self.case}: {self.law}" if self.case else self.law


def cases_of(root: Section) -> dict[str, Section]:
    """The root section of each case, by its name. `root` loses its key 'cases' and keeps everything else.

    Raises:
        ScenarioError: A case that replaces what belongs to all of them, or has a law of its own.
    """
    if "cases" not in root:
        return {}
    section = root.section("cases")
    if not section.left:
        raise section.error('needs one case at least: [cases."G = 100".plant.gears] with the keys that it replaces')
    if len(section.left) > MAX_CASES:
        raise section.error(f"has {len(section.left)} cases; at most {MAX_CASES} are read")
    laws = root.peek("laws")
    cases = {}
    for name in section.left:
        changes = section.section(name)
        changes.only(*OF_A_CASE, elsewhere=dict.fromkeys(OF_ALL_CASES, ", which all cases share"))
        theirs = changes.peek("laws")
        if not name.strip():
            raise section.error("has a case without a name")
        if isinstance(laws, dict) and isinstance(theirs, dict) and not theirs.keys() <= laws.keys():
            raise changes.error(
                f"changes the law {quoted_list([law for law in theirs if law not in laws])}, which [laws] does not "
                "have: every law runs in every case"
            )
        cases[name] = root.replaced(changes, f"{root.where}: case '{name}'")
    return cases
