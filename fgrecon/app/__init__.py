"""fgrecon as a service: programs ask over HTTP, people on a page. Presentation alone; see `docs/how-to/service.md`.

What cannot be used is refused by an `InvalidInputError` everywhere here; other errors are said where they are raised.
"""
