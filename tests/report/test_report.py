from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest
from example_diagnosis import RIG, example, model_of, recording_of

from twin.control import cosimulation, design
from twin.diagnosis import result
from twin.diagnosis.localization import Regime
from twin.display.numbers import measure, percent, time_left
from twin.estimation import two_stage
from twin.io.rig_file import Column
from twin.report import figures, html, wording
from twin.report.html import Check, Story
from twin.report.origin import trace_origin

SECTIONS = ["found", "where", "comparison", "residual", "rivals", "parameters", "recording", "next", "how"]
VOID = {"meta", "br", "link", "img", "input", "hr"}


class Page(HTMLParser):
    """Tags must close in order; text, ids and all attributes are kept."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(k, v or "") for k, v in attrs]
        self.ids += [v for k, v in attrs if k == "id" and tag == "section"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "title", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def story(**more) -> Story:
    return Story(**{"diagnosis": example(), "rig": RIG, "experiment_file": "next_experiment.csv", **more})


@cache
def usual_page() -> str:
    """Of the usual story, made once."""
    return html.html(story())


def test_page_is_whole_and_self_contained():
    text = usual_page()
    page = Page(text)
    assert [i for i in page.ids if i in SECTIONS] == SECTIONS
    assert not {"link", "img", "iframe", "object", "base"} & set(page.tags)
    shown = re.sub(r'id="explorer-data">.*?</script>', "", text)  # base64 may hold anything
    assert "http" not in shown and "//" not in shown and "@import" not in shown
    for name, value in page.attributes:
        if name in ("src", "href", "xlink:href"):
            assert value.startswith("#"), value
    assert "url(" not in text.replace("url(#", "")
    assert len(text) < 1e6


def test_page_says_what_was_wrong():
    page = Page(usual_page())
    said = page.text
    assert "The first model left out gravity on the link" in said
    assert "acts at the load" in said
    for number in ("3.100 ± 0.020", "62", "3.20", "0.300"):
        assert number in said, number
    assert "Not determined by this recording: motor share. What would help: add reversals" in said
    assert "the recording cannot fix it" not in said
    assert "0.0150 to 0.0260" in said  # the profile interval
    assert "Travel over more than half a turn." in said


def test_a_sign_is_explained_where_it_stands():
    """A load that changes is a condition in the equations; gravity is not."""
    changing = replace(example(), after=model_of("load_change"))
    assert "square bracket" in Page(html.html(story(diagnosis=changing))).text
    assert "square bracket" not in Page(usual_page()).text


def test_angles_stand_in_the_rig_s_own_unit_beside_si():
    degrees = Column("q", "rad", factor=np.pi / 180.0, written="deg")
    after = example().after
    gap = measure(np.degrees(after.values["backlash_gap"]), np.degrees(after.std("backlash_gap")), "deg")
    page = html.html(story(rig=replace(RIG, output=degrees)))
    assert gap in page and gap not in usual_page()


def test_text_from_files_is_escaped():
    text = usual_page()
    for raw in ("<jumps>", "<position>", "<disagree>"):
        assert raw not in text
        assert raw.replace("<", "&lt;").replace(">", "&gt;") in text
    d = example(several=True)
    evil = "<script>alert(1)</script>$x_{$.csv"
    renamed = tuple(replace(t, name=evil) for t in d.traces)
    recordings = tuple(replace(r, name=evil) for r in d.recordings)
    hostile = html.html(story(diagnosis=replace(d, traces=renamed, recordings=recordings, telling=evil)))
    assert Page(hostile).tags.count("script") == Page(text).tags.count("script")


def test_page_and_json_say_which_recording_tells_and_which_is_faulty():
    short, long = example(several=True).recordings[0], recording_of(model_of("gravity"), 6.0, "long.csv")
    d = replace(example(several=True), recordings=(short, long), telling="a.csv")
    page = Page(html.html(story(diagnosis=d))).text
    assert "The missing torque along a.csv" in page
    assert "long.csv: The output <jumps>" in page
    answer = result.to_json(d)
    assert answer["mismatch"]["recording"] == "a.csv"
    assert [f["recording"] for f in answer["recording_faults"]] == ["a.csv", "long.csv"]


@pytest.mark.parametrize("verdict", ["explained", "nothing_missing", "partly_explained", "unexplained"])
@pytest.mark.parametrize("several", [False, True])
def test_every_verdict_and_kind_of_recording(verdict, several):
    unit = "m" if several else "rad"
    text = html.html(story(diagnosis=example(verdict, several, unit), seconds={"in all": 3.0}))
    page = Page(text)
    assert {"found", "comparison", "residual"} <= set(page.ids)
    assert ("improved model" in page.text) == (verdict in ("explained", "partly_explained"))
    assert "nan" not in page.text.lower().split()


@pytest.mark.parametrize("verdict", ["explained", "nothing_missing", "partly_explained", "unexplained"])
def test_what_is_still_missing_is_said_where_something_is(verdict):
    """Where, when and how large, with a picture; and not a word of it where the figures support the model."""
    d = example(verdict)
    figures_of = replace(d.adequacy.missing_torque, after=1.25, of_drive=0.2)
    page = Page(html.html(story(diagnosis=replace(d, adequacy=replace(d.adequacy, missing_torque=figures_of)))))
    there = verdict in ("partly_explained", "unexplained")
    assert ("still-missing" in page.ids) == there
    assert (
        "1.2 rad/s² RMS of torque over inertia is still missing, 20 % of what the drive makes" in page.text
    ) == there


@pytest.mark.parametrize(
    ("regimes", "bias", "says"),
    [
        ([], 0.001, ""),
        ([("velocity", 2.0, 3.0)], 0.0, "It acts where the speed is from 2.0 to 3.0 rad/s."),
        (
            [("position", 6.1, 0.25, 6.2832)],
            -0.04,
            "It acts where the position is from 6.1 to 0.25 rad within each turn.",
        ),
        ([("input", -40.0, -20.0), ("input", 20.0, 40.0)], 0.0, "from −40 to −20 % and from 20 to 40 %."),
        ([("direction", -1.0, 0.0)], 0.0, "It acts in backward motion."),
        ([("position", float(i), i + 0.5) for i in range(9)], 0.12, ""),
    ],
)
def test_where_the_first_model_lacks_most_and_what_that_did_to_it_is_said(regimes, bias, says):
    d = replace(example("explained"), regimes=tuple(Regime(*r) for r in regimes), gain_bias=bias)
    said = wording.where(d)
    assert says in said and ("It acts" in said) == bool(says)
    size = {0.12: "12 % too large", -0.04: "4 % too small"}.get(bias)
    assert ("input gain" in said) == bool(size) and (size or "").replace(" %", "\u202f%") in said
    page = Page(html.html(story(diagnosis=d)))
    assert said.replace("\u202f", " ") in page.text.replace("\u202f", " ")
    kept = result.to_json(d)["mismatch"]
    assert kept["gain_bias"] == bias and [r["from"] for r in kept["regimes"]] == [r[1] for r in regimes]


def test_a_curve_without_a_name_is_said_and_shown():
    drawn = replace(example("unexplained"), after=model_of("unknown_gain"), depends_on=("position", "input"))
    curve = wording.title("unknown_gain")
    said = f"it goes with position and the command. Fitted in its place: {curve}."
    assert wording.headline(drawn).endswith(said)
    page = Page(html.html(story(diagnosis=drawn)))
    assert "improved model" in page.text and curve in page.text
    (sentence,) = wording.nameless(drawn)
    assert sentence.startswith("What the motor makes of a command") and sentence in page.text
    assert wording.sentences(drawn)[0] == f"{wording.headline(drawn)} {sentence}"
    assert 'class="station found"' in html._where(story(diagnosis=drawn)) and "is marked" in page.text


@pytest.mark.parametrize(
    ("verdict", "says"), [("nothing_missing", "nothing is missing in it"), ("unexplained", "cannot be said")]
)
def test_only_where_nothing_is_missing_does_the_machine_lack_nothing(verdict, says):
    page = Page(html.html(story(diagnosis=example(verdict))))
    assert says in page.text and ("nothing is missing in it" in page.text) == (verdict == "nothing_missing")


def test_controller_checks_and_two_stage_have_their_place():
    made = design.design(model_of("gravity"), 2.0)
    ran = cosimulation.simulate(model_of("gravity"), made, cosimulation.make_reference("minimum-jerk", made))
    good = Check("arm.fmu", "axis.csv", 0.1, 3.2, 1.0, ())
    checks = (good, replace(good, fmu="improved.fmu", problems=("bad <x>",)))
    simple = two_stage.two_stage(example().recordings)
    page = Page(html.html(story(controller=made, tracking=ran, checks=checks, two_stage=simple)))
    assert {"control", "two-stage"} <= set(page.ids)
    assert "phase margin" in page.text and "bad <x>" in page.text and "valid" in page.text


def test_same_story_gives_the_same_page():
    assert html.html(story()) == usual_page()


def test_thinning_keeps_every_peak():
    x = np.arange(100_000, dtype=float)
    y = np.sin(x / 5000.0)
    y[[777, 54_321]] = 9.0, -9.0
    y[60_000:70_000] = np.nan
    thin_x, thin_y = figures.thinned(x, y)
    assert len(thin_x) <= 2 * 1400
    assert np.nanmax(thin_y) == 9.0 and np.nanmin(thin_y) == -9.0
    assert np.all(np.diff(thin_x) > 0.0)
    assert np.isnan(thin_y[(thin_x > 60_200) & (thin_x < 69_800)]).all()


def test_chain_marks_the_station():
    drawn = figures.chain({"friction": ["dry <friction>"]})
    assert drawn.count("station found") == 1
    assert "dry &lt;friction&gt;" in drawn
    assert "station found" not in figures.chain({})


@pytest.mark.parametrize(
    ("value", "std", "unit", "says"),
    [
        (3.1019, 0.0213, "rad/s^2", "3.102 ± 0.021 rad/s²"),
        (-0.5, 0.13, "1", "−0.50 ± 0.13"),
        (52.4, float("nan"), "%", "52.40\u202f%"),
        (123456.0, 2345.0, "Hz", "123456 ± 2345 Hz"),
        (2.5e7, 3e5, "Hz", "(2.500 ± 0.030)·10⁷ Hz"),
        (-2e-9, 3e-8, "m", "(−0.2 ± 3.0)·10⁻⁸ m"),
        (0.0, 0.0, "s", "0 s"),
        (float("inf"), 1.0, "s", "– s"),
    ],
)
def test_numbers_are_put_into_words(value, std, unit, says):
    assert measure(value, std, unit) == says


@pytest.mark.parametrize(
    ("seconds", "done", "total", "says"),
    [
        (0.0, 0, 5, ""),
        (60.0, 2, 6, ", about 2 min left"),
        (9e3, 1, 2, ", about 2 h left"),
        (20.0, 4, 5, ", about 5 s left"),
        (5.0, 5, 5, ""),
    ],
)
def test_the_rest_of_like_work_takes_as_long_as_what_is_done(seconds, done, total, says):
    assert time_left(seconds, done, total) == says


def test_certainty_is_never_claimed():
    assert percent(1.0) == "over 99\u202f%"
    assert percent(0.0) == "under 1\u202f%"
    assert percent(0.5) == "50\u202f%"


def test_sentences_name_effect_and_both_errors():
    first, second, allowed = wording.sentences(example())
    assert allowed == example().adequacy.says
    assert "gravity on the link" in first
    assert "3.20" in second and "0.300" in second and "falls" in second
    worse = example()
    fits = {"before": worse.fit["train"]["after"], "after": worse.fit["train"]["before"]}
    assert "rises" in wording.fit_sentence(replace(worse, fit={"train": fits, "holdout": fits}))


def test_a_report_says_where_it_comes_from(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    (tmp_path / "log.csv").write_text("abc")
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/twin", "run", "my log.csv"])
    made = trace_origin([tmp_path / "log.csv", tmp_path / "none"], ["report.html"], ["twin check <x>"])
    page = Page(html.html(story(origin=made)))
    assert "1970-01-01T00:00:00+00:00" in page.text
    assert "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad" in page.text  # FIPS 180-2, appendix B.1
    assert "twin run 'my log.csv'" in page.text and "twin check <x>" in page.text
    assert "Where this page comes from" not in Page(usual_page()).text


def test_a_parameter_that_is_fixed_well_is_no_note():
    d = example()
    told = {**d.after.notes, "input_gain": "the recording cannot fix it; record more"}
    sharp = replace(d, after=replace(d.after, notes=told))
    assert "input gain" not in wording.undetermined_sentence(sharp.after)
