# fgrecon's command line: docker build -t fgrecon . && docker run --rm -v "$PWD:/data" fgrecon demo --out /data/demo
# The service for programs: docker run --rm -p 127.0.0.1:8000:8000 fgrecon serve --host 0.0.0.0
FROM python:3.11 AS build
COPY . /src
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /src

FROM python:3.11-slim
COPY constraints.txt /constraints.txt
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir --constraint /constraints.txt "$(echo /wheels/*.whl)[serve]" \
    && rm -rf /wheels \
    && useradd --create-home fgrecon

USER fgrecon
WORKDIR /data
ENTRYPOINT ["fgrecon"]
CMD ["--help"]
