"""The files that the readers' tests are made of, damaged, through `serve` and through the page: an answer in words."""

import asyncio
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fuzz.mutate import mutated
from benchmarks.fuzz.readers import READERS
from fgrecon.app.limits import LIMITS
from fgrecon.app.requested import PageRequested
from fgrecon.app.videos import track_upload
from fgrecon.app.visit import Visit, instances_in_boxes
from fgrecon.app.workers import Workers
from fgrecon.core.errors import FgreconError
from tests.conftest import REPOSITORY

CORPUS = sorted(path for path in (REPOSITORY / "tests/corpus").rglob("*") if path.is_file())
READ = ("keypoints", "track", "boxes", "camera", "kitti calibration", "picture")
ENDINGS = (".json", ".txt", ".yaml", ".png")
_DAMAGED = 6  # of each valid file


def attacks():
    """Content by a name of its own: the kept files, and valid ones damaged."""
    made = {f"kept-{path.name}": path.read_bytes() for path in CORPUS}
    for reader in READ:
        for title, content in READERS[reader].seeds().items():
            for number in range(_DAMAGED):
                name = f"{reader.replace(' ', '-')}-{number}-{title}"
                made[name] = mutated(content, np.random.default_rng(number))
    return made


@pytest.fixture(scope="module")
def damaged():
    return attacks()


def test_the_service_answers_each_and_goes_on(client, sample, damaged):
    answered = set()
    for name, content in damaged.items():
        for kind in ("application/json", "image/png"):
            status, answer = client.post(content, kind)
            answered.add(status)
            assert status in (200, 422), name
            text = json.dumps(answer)
            assert "Traceback" not in text, name
            assert tempfile.gettempdir() not in text, name
            if status == 422:
                assert answer["error"]["message"], name
    assert 422 in answered
    assert client.post((sample / "cars.json").read_bytes())[0] == 200


def test_the_page_answers_each_and_goes_on(sample, damaged):
    async def visit_with_each():
        workers = Workers(1, LIMITS, 60.0)
        street = (sample / "street.png").read_bytes()
        refused = {}
        try:
            for number, (name, content) in enumerate(damaged.items()):
                visit = Visit(workers, LIMITS, {}, PageRequested())
                ending = Path(name).suffix if Path(name).suffix in ENDINGS else ENDINGS[number % len(ENDINGS)]
                try:
                    if number % 4 == 0 and ending != ".png":  # beside a photograph
                        visit.take("street.png", street)
                    visit.take(Path(name).stem + ending, content)
                    await visit.solve()
                except FgreconError as error:
                    refused[name] = str(error)
            assert len(refused) > len(damaged) / 3
            for name, words in refused.items():
                assert words, name
                assert "Traceback" not in words, name
                assert tempfile.gettempdir() not in words, name
            good = Visit(workers, LIMITS, {}, PageRequested(camera_height="1.65"))
            good.take("cars.json", (sample / "cars.json").read_bytes())
            await good.solve()
            assert len(good.view.cars) == 3
        finally:
            workers.close()

    asyncio.run(visit_with_each())


def test_videos_that_are_none_are_refused_in_words(damaged, tmp_path):
    for number, content in enumerate([*damaged.values()][::15]):
        (tmp_path / "x.mp4").write_bytes(content)
        (out := tmp_path / str(number)).mkdir()
        with pytest.raises(FgreconError) as refused:
            track_upload(tmp_path, "x.mp4", out, PageRequested())
        assert str(tmp_path) not in str(refused.value)


@pytest.mark.parametrize(
    "box", [[5, 5, 5, 5], [50, 50, 10, 10], [float("nan")] * 4, [1e9, 1e9, 2e9, 2e9], [-9, -9, -5, -5]]
)
def test_boxes_that_are_none_are_refused(sample, box):
    with pytest.raises(FgreconError):
        instances_in_boxes(sample, "street.png", [box], PageRequested())
