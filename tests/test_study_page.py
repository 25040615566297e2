"""A study through its real pages in Chromium: whole studies while the server is killed, what is sent to them, how they look."""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from foten_study.languages import Language, read_language
from foten_study.store import Store
from foten_study.tasks.table import TASKS
from test_studio_page import CHROMIUM, chromium, look, playwright, until
from test_study_commands import SAID, started_study
from test_study_server import study_file

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt install chromium")]

# A simulated participant: does with the page what a hand does, and rates trial n with (37 n + 11) mod 101.
DRIVE = """() => {
  const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms)), $ = (s) => document.querySelector(s);
  const rating = (n) => (37 * n + 11) % 101;
  const stroke = async () => {
    const canvas = $("#pad"), box = canvas.getBoundingClientRect();
    canvas.setPointerCapture = () => {};
    const say = (type, x) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 7, pointerType: "pen", pressure: 0.5,
      clientX: box.left + x, clientY: box.top + 60, bubbles: true, buttons: 1 }));
    say("pointerdown", 20);
    for (let k = 1; k < 40; k++) { await wait(8); say("pointerrawupdate", 20 + 2 * k); }
    say("pointerup", 98);
  };
  window.ended = false;
  (async () => {
    let before = null, since = 0;
    while (true) {
      const { step, pending } = window.study, button = $("#content .big");
      if (step?.kind === "end") break;
      if (!step || pending || !button) { await wait(15); continue; }
      if (step.id === before && performance.now() - since < 4000) { await wait(15); continue; }
      [before, since] = [step.id, performance.now()];
      if (step.kind === "trial") {
        await stroke();
        const slider = $(".scale input");
        slider.value = rating(step.n);
        slider.dispatchEvent(new Event("input"));
      }
      for (const field of document.querySelectorAll("#content textarea")) field.value = "fine";
      $("#content input[type=radio]")?.click();
      button.click();
      await wait(5);
    }
    window.ended = true;
  })();
}"""


# More events than a page may send in a second, while the server is away: x, y, pressure, t.
OUTAGE = """() => {
  const events = Array.from({ length: 5760 }, (_, k) => [k / 100, 5, 0.5, performance.now() / 1000 + k / 240]);
  for (const event of events) window.study.event(...event);
  return events;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium("--autoplay-policy=no-user-gesture-required") as browser:
        yield browser


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextlib.contextmanager
def running(study: Path, *options: str) -> Iterator[tuple[str, str]]:
    """The links of the operator and of participants while a study runs."""
    process, operator, participants = started_study(study, *(options or ("--port", "0")))
    try:
        yield operator, participants
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=30)


def begin(page: Any, link: str) -> None:
    """Open the page, and begin as a new participant."""
    for _ in range(100):
        try:
            page.goto(link, timeout=5000)
            page.wait_for_selector("html[data-ready]", timeout=5000)
            break
        except playwright.Error:  # the server is away
            time.sleep(0.2)
    page.click("button.big")
    until(page, "window.study.code !== null", 40.0)


def to_trial(page: Any) -> None:
    for text in ("I agree", "Next", "Start"):
        page.click(f"button.big >> text={text}")
    until(page, "window.study.step?.kind === 'trial'")


def stroke_by_key(page: Any, ms: int) -> None:
    page.focus("#pad")
    page.keyboard.down("ArrowRight")
    page.wait_for_timeout(ms)
    page.keyboard.up("ArrowRight")


def local(link: str) -> str:
    """A link of a network, by the name that this machine has for itself."""
    return re.sub(r"//[^/]+:(\d+)", r"//127.0.0.1:\1", link)


def next_link(n: int) -> str:
    """The link that the study which was started last gives out once n devices have come."""
    deadline, lines = time.monotonic() + 10, [*SAID.values()][-1]
    while len(links := re.findall(r"for the next one: (\S+)", "".join(lines))) < n:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return str(links[-1])


def whole_study(browser: Any, folder: Path, n_textures: int, participants: int, kills: int) -> list[float]:
    """Let simulated participants answer through three devices at once, by HTTPS, while the server is killed.

    Returns:
        Seconds from each start of the server until all pages that were open are back.
    """
    study = study_file(folder, n_textures, 4, participants=participants, practice="1")
    options = ("--simulated", "--port", str(free_port()), "--host", "0.0.0.0")
    process, _, link = started_study(study, *options)
    contexts = [browser.new_context(ignore_https_errors=True) for _ in range(3)]
    for n, context in enumerate(contexts, start=1):  # each comes in by a link of its own, once
        context.new_page().goto(local(link))
        link = next_link(n)
    busy = {context.pages[0]: False for context in contexts}
    n_begun = n_finished = n_killed = 0
    rng, start, back = random.Random(3), time.monotonic(), []
    expected = participants * (n_textures * 4 + 6)
    due = sorted(rng.uniform(0.03, 0.9) for _ in range(kills))
    while n_finished < participants:
        assert time.monotonic() - start < 1500
        for page, is_busy in busy.items():
            if not is_busy and n_begun < participants:
                begin(page, local(link))
                page.evaluate(DRIVE)
                busy[page] = True
                n_begun += 1
            elif is_busy and page.evaluate("window.ended === true"):
                busy[page] = False
                n_finished += 1
        with Store(folder / "study.db") as store:
            share = sum(len(store.done(n)) for n in store.codes().values()) / expected
        if n_killed < kills and share > due[n_killed]:
            time.sleep(rng.uniform(0, 0.3))
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            process, _, link = started_study(study, *options)
            again = time.monotonic()
            for page, is_busy in busy.items():
                if is_busy:
                    until(page, "window.study.socket?.readyState === 1")
            back.append(time.monotonic() - again)
            n_killed += 1
        page.wait_for_timeout(30)
    assert n_killed == kills
    process.send_signal(signal.SIGTERM)
    process.wait(timeout=30)
    for context in contexts:
        context.close()
    return back


def check_study(database: Path, participants: int, n_trials: int) -> None:
    with Store(database) as store:
        assert store.check() == []
        assert store.simulated
        rows = store.ratings()
        assert len(rows) == participants * n_trials
        assert len({(row["participant"], row["trial"]) for row in rows}) == len(rows)
        for row in rows:
            assert row["rating"] == (37 * row["trial"] + 11) % 101
            assert len(store.strokes(row["participant"], row["trial"])) > 0
            assert row["measured"]["contact_s"] > 0
            assert row["response_s"] > 0
        for number in store.codes().values():
            designed = [(trial.texture, trial.method) for trial in store.trials(number) if not trial.practice]
            assert [(row["texture"], row["method"]) for row in rows if row["participant"] == number] == designed


@pytest.mark.parametrize(
    ("n_textures", "participants", "kills"),
    [(2, 3, 2), pytest.param(12, 21, 20, marks=pytest.mark.slow)],  # and the paper's study
)
def test_a_study_through_its_pages_while_the_server_is_killed(
    browser: Any, tmp_path: Path, n_textures: int, participants: int, kills: int
) -> None:
    back = whole_study(browser, tmp_path, n_textures, participants, kills)
    print(f"back after {', '.join(f'{seconds:.1f}' for seconds in back)} s")
    check_study(tmp_path / "study.db", participants, 4 * n_textures)


def test_nothing_is_chosen_before_someone_chooses_and_an_answer_is_kept_while_the_server_is_away(
    browser: Any, tmp_path: Path
) -> None:
    study, port = study_file(tmp_path, practice="0", min_seconds="2"), free_port()
    page = browser.new_page()
    with running(study, "--port", str(port)) as (_, link):
        begin(page, link)
        to_trial(page)
        assert page.get_attribute(".scale input", "aria-valuetext") == "not set"
        assert page.is_disabled("button.big")
        page.focus(".scale input")
        page.keyboard.press("ArrowRight")
        assert page.get_attribute(".scale input", "aria-valuetext") == "51"
        stroke_by_key(page, 700)
    until(page, "document.querySelector('#message').textContent.startsWith('No connection')")
    made = page.evaluate(OUTAGE)
    page.fill(".scale input", "83")
    until(page, "!document.querySelector('button.big').disabled")
    page.click("button.big")
    with running(study, "--port", str(port)):
        until(page, "window.study.step?.id === 'trial:2'")
    with Store(tmp_path / "study.db") as store:
        assert [row["rating"] for row in store.ratings()] == [83.0]
        strokes = store.strokes(1, 1).tolist()
        assert strokes[-len(made) :] == made
        assert len({t for *_, t in strokes}) == len(strokes)  # none is there twice
    page.close()


def test_a_trial_that_is_held_keeps_what_was_chosen_and_its_time(browser: Any, tmp_path: Path) -> None:
    """And the operator's row stays where it is: a press on it that lasts is a press."""
    with running(study_file(tmp_path, practice="0", operator="true")) as (operator, link):
        context = browser.new_context()
        other = context.new_page()
        other.goto(operator)
        other.click("#begin-one")
        until(other, "document.querySelector('#invite-code').textContent !== ''")  # the server was asked for it
        code = other.inner_text("#invite-code")
        other.wait_for_timeout(700)
        assert other.evaluate("document.querySelector('#invite').open")
        page = context.new_page()
        page.goto(f"{link}?code={code}")
        until(other, "!document.querySelector('#invite').open")  # it covers what the operator needs now
        to_trial(page)
        assert page.evaluate("window.study.step.held")

        def press(what: str, ms: int) -> None:
            other.wait_for_selector(f"[data-what={what}]:visible")
            box = other.locator(f"[data-what={what}]").bounding_box()
            other.mouse.move(box["x"] + 5, box["y"] + 5)
            other.mouse.down()
            other.wait_for_timeout(ms)
            other.mouse.up()

        press("Go", 1200)  # the page is told of the study twice meanwhile
        until(page, "window.study.step.held === false")
        page.fill(".scale input", "83")
        before = page.evaluate("window.study.seconds")
        press("Hold", 50)
        until(page, "window.study.step.held === true")
        assert page.is_disabled("button.big")
        at = page.evaluate("window.study.seconds")
        page.wait_for_timeout(200)
        assert page.evaluate("window.study.seconds") == at >= before
        press("Go", 50)
        until(page, "window.study.step.held === false")
        assert page.input_value(".scale input") == "83"
        page.click("button.big")
        until(page, "window.study.step.id === 'trial:2'")
        context.close()
    with Store(tmp_path / "study.db") as store:
        assert [row["rating"] for row in store.ratings()] == [83.0]


def test_a_tablets_clock_that_is_set_back_holds_no_trial_up(browser: Any, tmp_path: Path) -> None:
    with running(study_file(tmp_path, practice="0", min_seconds="1")) as (_, link):
        page = browser.new_page()
        begin(page, link)
        to_trial(page)
        page.evaluate("{ const clock = Date.now; Date.now = () => clock() - 3.6e6; }")
        stroke_by_key(page, 700)
        page.fill(".scale input", "40")
        until(page, "!document.querySelector('button.big').disabled")
        page.click("button.big")
        until(page, "window.study.step.id === 'trial:2'")
        # Set back, and the page is loaded again: it knows a time that is to come.
        page.evaluate("""() => {
          const known = JSON.parse(sessionStorage.getItem("foten-begun"));
          sessionStorage.setItem("foten-begun", JSON.stringify({ ...known, at: known.at + 3.6e6 }));
        }""")
        page.reload()
        until(page, "window.study.step?.id === 'trial:2' && window.study.seconds >= 0")
        page.close()
    with Store(tmp_path / "study.db") as store:
        (row,) = store.ratings()
        assert 0.7 < row["response_s"] < 30


def test_the_operator_reads_that_the_noise_has_ended_and_goes_on(browser: Any, tmp_path: Path) -> None:
    with running(study_file(tmp_path)) as (operator, _):
        page = browser.new_page()

        def told(route: Any) -> None:
            """What the server says, as after the end of the noise; `tests/test_study_server.py` has when it says so."""
            server = route.connect_to_server()
            server.on_message(lambda data: route.send(json.dumps({**json.loads(data), "noise_ended": True})))

        page.route_web_socket("**/operate", told)
        page.goto(operator)
        until(page, "!document.querySelector('#message').hidden")
        assert page.locator("#message").inner_text().startswith("The masking noise has ended")
        page.wait_for_selector("#begin-one:not([disabled])")
        page.click("#begin-one")
        until(page, "document.querySelectorAll('#people li').length === 1")
        page.close()


def test_a_page_whose_place_is_returned_begins_anew(browser: Any, tmp_path: Path) -> None:
    """Until something is answered; an age that nobody has is no answer."""
    with running(study_file(tmp_path)) as (operator_link, link):
        operator, page = browser.new_page(), browser.new_page()
        asked: list[str] = []
        operator.on("dialog", lambda dialog: (asked.append(dialog.message), dialog.accept()))
        operator.goto(operator_link)
        begin(page, link)
        code = page.evaluate("window.study.code")
        operator.click("[data-what='Return place']:visible")
        page.wait_for_selector("#code")  # which outlasts the page's loading anew
        until(page, "window.study?.code === null")
        assert page.evaluate("location.search") == ""
        until(operator, "document.querySelectorAll('#people li').length === 0")
        assert asked == [f"Return the place of participant 1, {code}? The next participant gets its order of trials."]
        page.click("button.big")
        until(page, f"window.study.code !== null && window.study.code !== '{code}'")
        operator.wait_for_selector("[data-what='Return place']:visible")
        page.click("button.big")
        operator.wait_for_selector("[data-what='Return place']", state="hidden")
        page.fill("input[name=age]", "-5")
        page.click("button.big")
        told = page.eval_on_selector("input[name=age]", "(input) => input.validationMessage")
        assert told == "Please enter a number: How old are you? (0–120)"
        page.fill("input[name=age]", "33")
        page.click("button.big")
        until(page, "window.study.step.kind === 'instructions'")
        operator.close()
        page.close()


def test_a_second_device_waits_for_the_operator_to_let_it_go_on(browser: Any, tmp_path: Path) -> None:
    def device(to: str) -> Any:
        page = browser.new_context(ignore_https_errors=True).new_page()
        page.goto(local(to))
        page.wait_for_selector("html[data-ready]")
        return page

    options = ("--port", "0", "--host", "0.0.0.0")
    with running(study_file(tmp_path, practice="0"), *options) as (operator_link, link):
        operator, first = device(operator_link), device(link)
        second = device(next_link(2))
        first.click("button.big")
        until(first, "window.study.code !== null")
        to_trial(first)
        code = first.evaluate("window.study.code")
        for what, then in (("Refuse", "Not on this device"), ("Allow", "How similar")):
            second.fill("#code", code)
            second.click("button.big")
            until(second, "document.querySelector('#content').textContent.includes('let this one go on: request')")
            operator.wait_for_selector(f"[data-what={what}]:visible")
            assert "another device asks to go on: request" in operator.inner_text("#people")
            operator.click(f"[data-what={what}]")
            until(second, f"document.querySelector('#content').textContent.includes('{then}')")
            operator.wait_for_selector(f"[data-what={what}]", state="hidden")
            if what == "Refuse":
                assert first.evaluate("window.study.socket.readyState") == 1
                second.reload()
        until(first, "document.querySelector('#content').textContent.includes('Open on another page')")
        assert second.evaluate("window.study.step.id") == "trial:1"
        second.reload()  # by the code in its address, as its own
        until(second, "window.study.step?.id === 'trial:1'")


# Visible texts of a page; those that are cut; those under the message, or under the ring around what has the focus.
LOOK = """() => {
  const dialog = document.querySelector("dialog[open]"), message = document.querySelector("#message");
  const texts = [], cut = [], covered = [], seen = [];
  for (const element of (dialog ?? document.body).querySelectorAll("*")) {
    if (!element.checkVisibility({ visibilityProperty: true })) continue;
    for (const name of ["aria-label", "aria-valuetext", "placeholder", "title", "alt"])
      if (element.getAttribute(name)) texts.push(element.getAttribute(name));
    const isInline = getComputedStyle(element).display === "inline";
    const isCut = !isInline && (element.scrollWidth > element.clientWidth || element.scrollHeight > element.clientHeight);
    for (const node of element.childNodes) {
      if (node.nodeType !== Node.TEXT_NODE || !node.data.trim()) continue;
      texts.push(node.data.trim());
      if (isCut) cut.push(node.data);
      const range = document.createRange();
      range.selectNodeContents(node);
      for (const box of range.getClientRects()) seen.push({ element, box, text: node.data });
    }
  }
  const meets = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const within = (a, b) => a.left >= b.left && a.right <= b.right && a.top >= b.top && a.bottom <= b.bottom;
  const grown = (a, by) => ({ left: a.left - by, right: a.right + by, top: a.top - by, bottom: a.bottom + by });
  const focused = document.activeElement.closest(".choice") ?? document.activeElement;
  let { outlineOffset, outlineWidth, outlineStyle } = getComputedStyle(focused), box = focused.getBoundingClientRect();
  let inner = parseFloat(outlineOffset), outer = outlineStyle === "none" ? inner : inner + parseFloat(outlineWidth);
  if (focused.matches(".scale input:focus-visible") && outlineStyle === "none") { // around its track, in its middle
    const middle = (box.top + box.bottom) / 2, half = 0.3 * parseFloat(getComputedStyle(document.documentElement).fontSize);
    [box, inner, outer] = [{ left: box.left, right: box.right, top: middle - half, bottom: middle + half }, 3, 6];
  }
  for (const { element, box: at, text } of seen) {
    if (outer > inner && meets(at, grown(box, outer)) && !within(at, grown(box, inner))) covered.push(["ring", text]);
    if (!message.hidden && element !== message && meets(at, message.getBoundingClientRect())) covered.push(["message", text]);
  }
  const small = [...document.querySelectorAll(".choice")].filter((choice) => choice.clientHeight < 44);
  return { texts, cut, covered, small: small.map((choice) => choice.textContent) };
}"""


def faults_in(page: Any, name: str, language: Language) -> list[Any]:
    """What is of another language, cut, covered or small on a page, and what axe-core complains of."""
    texts = [re.escape(text) for text in (*language.words.values(), *language.new.values())]
    known = "|".join([re.sub(r"\\{\w+\\}", ".+", text) for text in texts])
    known += r"|Surfaces|Artificial grass|[ABX]|[\d.,]+( / \d+| dB)?"
    faults = look(page, f"study-{language.code}-{name}", ("landscape",))
    seen = page.evaluate(LOOK)
    faults += [(name, "of another language", text) for text in seen["texts"] if not re.fullmatch(known, text, re.S)]
    return faults + [(name, what, seen[what]) for what in ("cut", "covered", "small") if seen[what]]


@pytest.mark.parametrize(
    "code", ["de", *(pytest.param(c, marks=pytest.mark.slow) for c in ("en", "fr", "es", "ja", "ko", "zh"))]
)
def test_a_participant_reads_one_language_and_all_of_each_text(browser: Any, tmp_path: Path, code: str) -> None:
    """Through all pages: nothing of another language, nothing cut or covered, nothing that axe-core complains of."""
    changes = {"practice": "1", "break_every": "1", "real_checked": "true", "min_seconds": "2"}
    study = study_file(tmp_path, 1, 2, language=code, **changes)
    text = study.read_text(encoding="utf-8").replace("required = false", "required = true", 2)
    study.write_text(text, encoding="utf-8")
    language = read_language(code)
    context = browser.new_context()
    page = context.new_page()
    faults: list[Any] = []
    heights: set[int] = set()  # of the surface, which does not move
    page.on("pageerror", lambda error: faults.append(str(error)))

    def check(name: str) -> None:
        faults.extend(faults_in(page, name, language))

    def lacks(key: str, **values: object) -> None:
        until(page, f"document.querySelector('#lacks').textContent === {json.dumps(language.say(key, **values))}")
        assert page.is_disabled("button.big")
        check(key)
        heights.add(page.evaluate("document.querySelector('#pad').clientHeight"))

    def go_on(kind: str) -> None:
        page.click("button.big")
        until(page, f"window.study.step?.kind === '{kind}'")
        check(kind)

    with running(study) as (_, link):
        page.goto(link)
        page.wait_for_selector("html[data-ready]")
        check("welcome")
        page.click("button.link")
        check("settings")
        page.click("#weigh")
        check("settings-mouse")
        page.evaluate("window.study.settings.pressure = 0.5")
        for grams in ("10", "100"):
            page.fill("#grams", grams)
            page.click("#add")
        check("settings-weighed")
        page.click("#paper")
        page.keyboard.press("Escape")
        page.fill("#code", "AAAAA")
        page.keyboard.press("Enter")
        until(page, "!document.querySelector('#message').hidden")
        check("refused")
        page.fill("#code", "")
        page.click("button.big")
        until(page, "window.study.step?.kind === 'consent'")
        check("consent")
        go_on("questions")
        page.click("button.big")
        invalid = "[...document.querySelectorAll('input:invalid')].map((field) => field.validationMessage)"
        missing = [language.say("answer_missing", question=language.new[key]) for key in ("age", "handedness")]
        assert page.evaluate(invalid)[:2] == missing
        page.fill("input[type=number]", "40")
        for i in range(3):
            page.focus(f"fieldset >> nth={i} >> input >> nth=0")
            page.keyboard.press("Space")
            check(f"choice-{i}")
        go_on("instructions")
        page.click("button.big")
        until(page, "window.study.step?.kind === 'trial'")
        lacks("stroke_first")
        stroke_by_key(page, 500)
        lacks("touch_real", real=language.words["real_surface"])
        page.focus(".real")
        page.keyboard.press("Enter")
        page.reload()  # what counts was counted, but for the time: by the page's own clock it begins anew
        until(page, "window.study.step?.kind === 'trial'")
        page.evaluate("window.study.clock.at = Date.now() + 1e6")
        page.evaluate("window.study.check()")
        lacks("explore_first", s=2)
        page.evaluate("window.study.clock.at -= 2e6")
        page.evaluate("window.study.check()")
        lacks("choose_place")
        page.focus(".scale input")
        page.keyboard.press("ArrowRight")
        until(page, "!document.querySelector('button.big').disabled")
        check("chosen")
        for key in ("no_connection", "not_stored"):
            page.evaluate(f"window.study.show({json.dumps(language.words[key])}, true)")
            check(key)
        page.evaluate("window.study.show('')")
        page.click("button.big")
        other = context.new_page()
        until(page, "window.study.step.id === 'trial:1'")
        other.goto(page.url)
        until(page, "document.querySelector('h2') !== null && window.study.step.id === 'trial:1'")
        page.wait_for_selector(f"h2 >> text={language.words['moved_heading']}")
        check("moved")
        page, _ = other, page.close()
        page.on("pageerror", lambda error: faults.append(str(error)))
        for kind in ("break", "questions"):
            until(page, "window.study.step?.kind === 'trial'")
            stroke_by_key(page, 500)
            page.click(".real")
            page.fill(".scale input", "70")
            page.wait_for_timeout(2200)
            go_on(kind)
            if kind == "break":
                page.click("button.big")
        page.fill("textarea", "…")
        go_on("end")
    until(page, "!document.querySelector('#message').hidden")
    check("no-connection")
    context.close()
    assert not faults
    assert len(heights) == 1


@pytest.mark.slow
def test_the_pages_are_accessible_and_look_as_the_screenshots_show(browser: Any, tmp_path: Path) -> None:
    context = browser.new_context()
    violations: list[Any] = []
    context.on("weberror", lambda failed: violations.append(str(failed.error)))

    def check(page: Any, name: str) -> None:
        sizes = ("phone", "tablet", "desktop") if name in ("trial", "operator") else ("phone", "desktop")
        violations.extend(look(page, f"study-{name}", sizes))

    with running(study_file(tmp_path, practice="0", break_every="1")) as (operator, link):
        other = context.new_page()
        other.goto(operator)
        other.wait_for_selector("#none:visible >> text=Scan its code with the tablet")
        assert not other.is_visible("#lets-go")
        check(other, "operator-empty")
        page = context.new_page()
        page.goto(link)
        page.wait_for_selector("html[data-ready]")
        check(page, "join")
        for kind in ("consent", "questions", "instructions", "trial"):
            page.click("button.big")
            until(page, f"window.study.step?.kind === '{kind}'")
            check(page, kind)
        page.click(".real")
        other.wait_for_selector("#people >> text=on the real surface, 1 switch")
        assert other.is_visible("text=Whether the real surface is touched is not checked.")
        check(other, "operator")
        other.click("[data-what=Code]")
        other.wait_for_selector("#invite[open] img")
        check(other, "code")
        page.fill(".scale input", "64")
        check(page, "rated")
        page.click("button.big")
        until(page, "window.study.step?.kind === 'break'")
        check(page, "break")
    context.close()
    assert not violations


# A pen at x px that moves by 3 px at each of n events; how long it stays on, in ms.
STROKE = """([x, n, ms]) => {
  const canvas = document.querySelector("#pad"), box = canvas.getBoundingClientRect();
  canvas.setPointerCapture = () => {};
  const say = (type, dx) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 7, pointerType: "pen", pressure: 0.5,
    clientX: box.left + x + dx, clientY: box.top + 150, bubbles: true, buttons: 1 }));
  say("pointerdown", 0);
  for (let k = 1; k <= n; k++) say("pointerrawupdate", 3 * k);
  const lift = (done) => { if (n) say("pointerrawupdate", 3 * n); say("pointerup", 3 * n); setTimeout(done, 60); };
  return new Promise((done) => setTimeout(() => lift(done), ms));
}"""
SCALES = "".join(
    f'[[scales]]\nkey = "{key}"\nquestion = "How {key} is it?"\nlowest = "not {key}"\nhighest = "very {key}"\n'
    for key in ("rough", "hard", "sticky")
)


@pytest.mark.parametrize(
    ("kind", "names", "code"),
    [
        ("oddity", "123", "fr"),
        ("rating", "", "en"),
        pytest.param("paired", "AB", "de", marks=pytest.mark.slow),
        pytest.param("abx", "ABX", "ja", marks=pytest.mark.slow),
        pytest.param("threshold", "123", "ko", marks=pytest.mark.slow),
    ],
)
def test_a_trial_of_each_kind_is_stroked_and_answered(
    browser: Any, tmp_path: Path, kind: str, names: str, code: str
) -> None:
    """Each surface is asked for, what is chosen is stored with its contact, and the page looks well."""
    language = read_language(code)
    study = study_file(tmp_path, 1, 2, language=code, practice="0", min_seconds="0.5")
    task = f'kind = "{kind}"' + "\nrepeats = 4" * TASKS[kind].order.pairs
    text = study.read_text(encoding="utf-8").replace('kind = "rating"', task)
    # Questions are those of the task, in the study's language.
    text = re.sub("^(question|lowest|highest) = .*\n", "", text, flags=re.M)
    study.write_text(text + SCALES * (kind == "rating"), encoding="utf-8")
    with running(study) as (operator, link):
        page = browser.new_context(viewport={"width": 1024, "height": 768}).new_page()
        faults: list[Any] = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        begin(page, link)
        for following in ("questions", "instructions", "trial"):
            page.click("button.big")
            until(page, f"window.study.step?.kind === '{following}'")
        page.evaluate(STROKE, [99, 0, 400])
        assert not page.query_selector(".intervals .stroked")  # to the server that is no stroke either
        for i, name in enumerate(names or "1"):
            assert page.is_disabled("button.big")
            if names:
                page.click(f".intervals button >> text={name}")
            page.evaluate(STROKE, [200 + 120 * i, 33, 60])
        if kind == "rating":
            for slider in page.query_selector_all(".scale input"):
                assert page.is_disabled("button.big")
                slider.fill("30")
        else:
            until(page, f"document.querySelector('#lacks').textContent === '{language.words['choose']}'")
            faults += faults_in(page, kind, language)
            page.click(".asked .choice >> nth=1")
        if kind == "oddity":
            other = page.context.new_page()
            other.goto(operator)
            other.wait_for_selector("[data-what=Hold]:visible")
            assert not other.is_visible("[data-what=Real]")  # there is none to touch
            assert not other.is_visible("#unchecked")
            other.close()
        chosen = faults_in(page, f"{kind}-chosen", language)  # the scales of a rating are the author's
        faults += [fault for fault in chosen if not (kind == "rating" and "of another language" in fault)]
        until(page, "!document.querySelector('button.big').disabled")
        page.click("button.big")
        until(page, "window.study.step?.id === 'trial:2'")
        assert not page.query_selector(".intervals .stroked")
        assert not page.query_selector("input:checked")
        page.close()
    assert faults == []
    with Store(tmp_path / "study.db") as store:
        rows, parts = store.ratings(), store.parts(1, 1)
    if kind == "rating":
        assert {row["scale"]: row["rating"] for row in rows} == {"rough": 30.0, "hard": 30.0, "sticky": 30.0}
        return
    assert [(row["scale"], row["rating"]) for row in rows] == [("choice", 1.0)]
    assert {part.interval for part in parts if len(part.events)} == set(range(len(names)))
    assert all(rows[0]["measured"][f"contact_s_{i + 1}"] > 0.03 for i in range(len(names)))
