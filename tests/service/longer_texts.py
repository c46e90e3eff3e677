"""A generated language: the English texts of the built pages, longer by forty percent, as translations can be."""

import json

from playwright.async_api import Page, Route

from tests.service.browser_pages import ROOT


async def lengthen_page_texts(page: Page, key: str) -> str:
    """Load a page anew whose texts are replaced on their way to the browser; return what one of them became."""
    texts = json.loads((ROOT / "web/src/locales/en.json").read_text(encoding="utf-8"))
    replaced: set[str] = set()

    async def answer_with_longer_texts(route: Route) -> None:
        answer = await route.fetch(max_retries=3)  # the service may close an idle connection just then
        source = await answer.text()
        for each, text in texts.items():
            for quote in ('"', "`", "'"):
                written = f"{each}:{quote}{text}{quote}"
                if written in source:
                    source = source.replace(written, f"{each}:{quote}{lengthen_text(text)}{quote}")
                    replaced.add(each)
        await route.fulfill(response=answer, body=source)

    await page.route("**/assets/*.js", answer_with_longer_texts)
    await page.reload()
    await page.locator("main h1").first.wait_for()
    assert len(replaced) >= 0.9 * len(texts)
    return lengthen_text(texts[key])


def lengthen_text(text: str) -> str:
    """Return a text that is forty percent longer and looks translated; what is in braces stays."""
    vowels = str.maketrans("aeiouAEIOU", "åéîöüÅÉÎÖÜ")
    parts = text.split("{")
    done = [parts[0].translate(vowels)]
    for part in parts[1:]:
        name, _, rest = part.partition("}")
        done.append(f"{name}}}{rest.translate(vowels)}")
    more = "~" * max(1, round(0.4 * len(text)))
    return "{".join(done) + " ".join(more[at : at + 10] for at in range(0, len(more), 10))
