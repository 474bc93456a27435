"""The folder of an earlier comparison, which may be a stranger's."""

from contextlib import nullcontext

import pytest
from composing import composed

from lmd.core.checks import InputError
from lmd.evaluation.comparison import OptimiserRun
from lmd.optimisers.ledger import Record
from lmd.scene.deployment import Deployment
from pipelines.contenders import FILES, Contender, contend, kept_of
from pipelines.operations.tracking import NoTracker


@pytest.fixture
def left(tmp_path):
    """A job, and the folder of a comparison that has done it."""
    job = Contender("ega", composed("optimise", "optimiser=ega"), 0)
    run = OptimiserRun("ega", 0, {"x": 0.5}, [Record(1.0, 0.5, 0.1)], Deployment([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]))
    job.save(tmp_path / "earlier", run, None, ups=False)
    return job, tmp_path / "earlier"


def test_what_a_comparison_left_is_copied_and_no_more(left, tmp_path):
    job, earlier = left
    secret = tmp_path / "secret.txt"
    secret.write_text("mine")
    (job.folder(earlier) / "more.txt").symlink_to(secret)
    (job.folder(earlier) / "folder").symlink_to(tmp_path)
    assert list(kept_of(earlier, [job], tmp_path / "now").runs) == [job]
    assert sorted(path.name for path in job.folder(tmp_path / "now").iterdir()) == sorted(FILES)


@pytest.mark.parametrize("name", [*FILES, None])
def test_a_link_that_leads_out_of_it_is_refused(left, tmp_path, name):
    job, earlier = left
    outside = tmp_path / "outside"
    linked = job.folder(earlier) if name is None else job.folder(earlier) / name
    linked.rename(outside)
    linked.symlink_to(outside)
    with pytest.raises(InputError, match=r"^resume: .* is a link that leads out of the folder\."):
        kept_of(earlier, [job], tmp_path / "now")
    assert not (tmp_path / "now").exists()


def test_a_run_that_was_kept_and_not_logged_is_logged_when_the_comparison_goes_on(left, monkeypatch):
    job, earlier = left
    tracker, logged, replaced = NoTracker(), [], []
    monkeypatch.setattr("pipelines.tracked_run.tracked", lambda *_: nullcontext(tracker))
    monkeypatch.setattr("pipelines.contenders.run_directory", lambda: earlier)
    monkeypatch.setattr(tracker, "keep_newest", replaced.append)
    cfg = composed("compare", f"resume={earlier}", "workers=1")
    for _ in range(2):
        contend(cfg, [job], lambda _: False, lambda *_: [], lambda job, *_: logged.append(job))
    assert logged == [job]
    assert [tags["job"] for tags in replaced] == [job.tags["job"]]  # one may be recorded in part
