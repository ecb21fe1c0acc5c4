"""The service's OpenAPI document, made from the fields of a request, and a page of it."""

from __future__ import annotations

import html
from dataclasses import fields
from functools import cache
from importlib.resources import files
from typing import Any

from fgrecon.app.limits import Limits
from fgrecon.app.requested import Requested
from fgrecon.batch.file_service import installed_version

SCHEMAS = ("keypoints.schema.json", "results.schema.json")
"""Those that requests and answers have."""

_ANSWERS = {
    "400": "The connection was cut, or the host is not one that is served.",
    "408": "The body did not come in time.",
    "413": "The body is too large.",
    "415": "The body is of no kind that is taken.",
    "422": "The input cannot be used: field, value and fix are said.",
    "503": "Too many requests wait already; try again.",
}


@cache
def schema(name: str) -> str:
    """The text of a published schema."""
    return (files("fgrecon") / "data" / "schemas" / name).read_text(encoding="utf-8")


def openapi(limits: Limits) -> dict[str, Any]:
    """The OpenAPI document."""
    keypoints, results = ({"schema": {"$ref": f"/schemas/{name}"}} for name in SCHEMAS)
    image = {"schema": {"type": "string", "format": "binary"}}
    error = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    refusals = {code: {"description": words, "content": error} for code, words in _ANSWERS.items()}
    post = {
        "summary": "Pose and shape of the vehicles of an image, or of keypoints.",
        "description": f"At most {limits.upload_bytes} bytes, {limits.solve_seconds:g} seconds of work.",
        "operationId": "reconstruct",
        "parameters": [_parameter(entry) for entry in fields(Requested)],
        "requestBody": {
            "required": True,
            "content": {
                "application/json": keypoints,
                **{f"image/{kind}": image for kind in ("jpeg", "png", "webp", "bmp", "tiff")},
            },
        },
        "responses": {"200": {"description": "Results.", "content": {"application/json": results}}, **refusals},
    }
    health = {
        "summary": "Whether it works, with how many workers, and how many requests wait.",
        "operationId": "health",
        "responses": {"200": {"description": "It does.", "content": {"application/json": {"schema": _HEALTH}}}},
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "fgrecon", "version": installed_version(), "license": {"name": "MIT", "identifier": "MIT"}},
        "paths": {"/reconstruct": {"post": post}, "/health": {"get": health}},
        "components": {"schemas": {"Error": _ERROR}},
    }


_TEXT = {"type": "string"}
_HEALTH = {
    "type": "object",
    "required": ["status", "workers", "waiting"],
    "properties": {"status": {"const": "ok"}, "workers": {"type": "integer"}, "waiting": {"type": "integer"}},
}
_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {
        "error": {
            "type": "object",
            "required": ["type", "message"],
            "properties": {"type": _TEXT, "message": _TEXT, "field": _TEXT, "fix": _TEXT},
        }
    },
}


def _parameter(entry: Any) -> dict[str, Any]:
    choices = [str(choice) for choice in entry.metadata.get("choices", ())]
    kind: dict[str, Any] = _TEXT | ({"enum": choices} if choices else {})
    several = {"schema": {"type": "array", "items": kind}, "explode": True} if entry.name == "box" else {"schema": kind}
    return {"name": entry.name, "in": "query", "description": entry.metadata["words"], **several}


_STYLE = (
    ":root{color-scheme:light dark}"
    "body{font:16px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:46rem;padding:0 1rem}"
    "table{border-collapse:collapse;width:100%}td{border-top:1px solid #8886;padding:.3rem .5rem;vertical-align:top}"
    "pre{overflow-x:auto;background:#8882;padding:.7rem}"
)


def page(limits: Limits) -> str:
    """The OpenAPI document for people, as HTML that loads nothing."""
    content = openapi(limits)
    parts = []
    for path, methods in content["paths"].items():
        for method, operation in methods.items():
            parts.append(f"<h2>{method.upper()} {path}</h2><p>{html.escape(operation['summary'])}</p>")
            rows = [(entry["name"], _words(entry)) for entry in operation.get("parameters", ())]
            kinds = ", ".join(operation.get("requestBody", {}).get("content", ()))
            parts += [f"<p>Body: {kinds}. {html.escape(operation['description'])}</p>"] if kinds else []
            parts += [_table(rows)] if rows else []
            parts.append(_table([(code, one["description"]) for code, one in operation["responses"].items()]))
    schemas = ", ".join(f'<a href="/schemas/{name}">{name}</a>' for name in SCHEMAS)
    example = "curl --data-binary @cars.json -H 'Content-Type: application/json' \\\n  'http://HOST/reconstruct?size_prior=kitti'"
    return (
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>fgrecon</title><style>{_STYLE}</style><h1>fgrecon {html.escape(installed_version())}</h1>"
        f"<pre>{html.escape(example)}</pre>{''.join(parts)}"
        f"<p>Schemas: {schemas}. The same for programs: <a href=/openapi.json>openapi.json</a>.</p>"
    )


def _words(entry: dict[str, Any]) -> str:
    choices = ", ".join(entry["schema"].get("enum", ()))
    return f"{entry['description']} {choices}".strip()


def _table(rows: list[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><td><code>{html.escape(n)}</code><td>{html.escape(words)}" for n, words in rows)
    return f"<table>{cells}</table>"
