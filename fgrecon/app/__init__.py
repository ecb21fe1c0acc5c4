"""fgrecon as a service: programs ask over HTTP, people on a page. Presentation alone; see `docs/how-to/service.md`."""
