"""Write the shipped manifests and their cards: ``python manifests/generate.py`` (or ``make manifests``)."""

from pathlib import Path

from eldata.manifest.card import save_card
from eldata.manifest.eld import published_eld
from eldata.manifest.table import save_records

FOLDER = Path(__file__).parent


def main() -> None:
    """Write every manifest that the package ships."""
    for card, records in (published_eld(),):
        save_records(FOLDER / f"{card.name}.csv", records)
        save_card(FOLDER / f"{card.name}.json", card)


if __name__ == "__main__":
    main()
