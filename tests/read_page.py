"""A report's page read back: sections, sentences, tables and figures as a browser would find them."""

from dataclasses import dataclass, field
from html.parser import HTMLParser


@dataclass
class ReadTable:
    """Caption, column heads and rows of cells."""

    caption: str = ""
    heads: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)


@dataclass
class ReadSection:
    """One part of the page."""

    anchor: str
    title: str = ""
    paragraphs: list[str] = field(default_factory=list)
    tables: list[ReadTable] = field(default_factory=list)
    figures: list[str] = field(default_factory=list)
    captions: list[str] = field(default_factory=list)

    def table(self, beginning: str) -> ReadTable:
        """The table whose caption begins so."""
        (found,) = [t for t in self.tables if t.caption.startswith(beginning)]
        return found


class Page(HTMLParser):
    """What stands on a page; `asks` are addresses it would fetch, `scripts` and `handlers` what it would run."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.title, self.lead = "", ""
        self.facts: dict[str, str] = {}
        self.links: list[tuple[str, str]] = []
        self.front = ReadSection("front")
        self.sections: list[ReadSection] = []
        self.asks: list[str] = []
        self.scripts = 0
        self.handlers: list[str] = []
        self._open: list[str] = []
        self._text = ""
        self._target = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        held = dict(attributes)
        addresses = [held[k] for k in ("src", "href", "xlink:href", "srcset") if k in held]
        self.asks += [a for a in addresses if a[:1] != "#" and not a.startswith("data:")]
        self.scripts += tag == "script"
        self.handlers += [k for k in held if k.startswith("on")]
        if tag == "section":
            self.sections.append(ReadSection(held["id"]))
        elif tag == "figure":
            self._place.figures.append(held["id"])
        elif tag == "table":
            self._place.tables.append(ReadTable())
        elif tag == "tr" and "tbody" in self._open:
            self._place.tables[-1].rows.append([])
        elif tag == "a":
            self._target = held["href"]
        if tag not in ("meta", "br", "link", "img"):
            self._open.append(tag)
        if tag != "span":  # which stands within a text
            self._text = ""

    @property
    def _place(self):
        """The section that is being read, or the first page."""
        return self.sections[-1] if self.sections else self.front

    def handle_data(self, text):
        self._text += text

    def handle_endtag(self, tag):
        text = self._text.strip()
        place = self._place if {"section", "table", "figure"} & set(self._open) else None
        if tag == "h1":
            self.title = text
        elif tag == "dt":
            self._target = text
        elif tag == "dd":
            self.facts[self._target] = text
        elif tag == "a":
            self.links.append((self._target, text))
        elif tag == "p" and place is None:
            self.lead = text
        elif place is not None:
            self._of_section(place, tag, text)
        if tag in self._open:
            del self._open[len(self._open) - 1 - self._open[::-1].index(tag) :]

    def _of_section(self, place, tag, text):
        if tag == "h2":
            place.title = text
        elif tag == "p":
            place.paragraphs.append(text)
        elif tag == "caption":
            place.tables[-1].caption = text
        elif tag == "th":
            place.tables[-1].heads.append(text)
        elif tag == "td":
            place.tables[-1].rows[-1].append(text)
        elif tag == "figcaption":
            place.captions.append(text)

    def section(self, title: str) -> ReadSection:
        """The section of that title."""
        (found,) = [s for s in self.sections if s.title == title]
        return found
