"""The tables of docs/results/desk.md, from a few records."""

from pathlib import Path

from ablations.report.desk import STAND_INS, choices_table, stand_in_table
from ablations.study.description import MethodDescription, TableDescription, write_description
from ablations.study.rows import RowFile, line_of
from gaussian_enhancer.metrics.records import Record


def measured(run: str, view: str, variant: str, psnr: float, seed: int | None = 0) -> Record:
    metrics = {"psnr": psnr, "psnr_aligned": psnr, "ssim": psnr / 100, "lpips_alex": 1 / psnr}
    return Record("quality", run, run, "3dgs", view, variant, metrics, seed=seed, commit="c", machine="m", time="t")


def write(path: Path, records: list[Record]) -> None:
    RowFile(path, ("run", "view", "variant", "seed")).add_lines(list(map(line_of, records)))


def test_a_stand_in_is_the_mean_over_fits_of_the_first_seed(tmp_path: Path) -> None:
    methods = {"paper_ge": -0.1, "paper_gepp": 0.0, "ge": 1.0, "gepp": 2.0}
    views = [("a", "0.png", 20.0), ("a", "1.png", 30.0), ("b", "0.png", 27.0)]
    records = [measured(run, view, "raw", psnr, None) for run, view, psnr in views]
    for name, gain in methods.items():
        more = {"a": 0.0, "b": 1.0}
        records += [measured(run, view, name, psnr + gain + more[run]) for run, view, psnr in views]
        records += [measured(run, view, name, psnr + 9, seed=1) for run, view, psnr in views]
    for table in STAND_INS:
        write(tmp_path / f"{table}.jsonl", records)
    _, _, first, *others = stand_in_table(tmp_path).splitlines()
    assert first == "| unbounded ([table 2](tables/desk/table_2.md)) | 26.00 | +0.40 | +0.50 | +1.50 | +2.50 |"
    assert len(others) == len(STAND_INS) - 1


def test_choices_are_ordered_by_their_gain_below_our_own(tmp_path: Path) -> None:
    methods = {name: MethodDescription(name, f"about {name}") for name in ("raw", "good", "ours", "bad")}
    table = TableDescription("mode", "t", "quality", "", methods, "raw", ("psnr",), ("3dgs",), {})
    write_description(tmp_path / "mode.json", table)
    records = [measured("a", view, "raw", 20.0, None) for view in ("0.png", "1.png")]
    for name, gain in (("good", 3.0), ("ours", 2.0), ("bad", -1.0)):
        records += [measured("a", "0.png", name, 20 + gain), measured("a", "1.png", name, 21 + gain)]
    write(tmp_path / "mode.jsonl", records)
    _, _, *rows = choices_table(tmp_path / "mode.jsonl").splitlines()
    assert [row.split(" | ")[0] for row in rows] == ["| about ours", "| about bad", "| about good"]
    assert rows[1].split(" | ")[1] == "-0.500"
    assert rows[1].split(" | ")[-1] == "-1.00 |"
