# fgrecon's command line: docker build -t fgrecon . && docker run --rm -v "$PWD:/work" fgrecon demo --out /work/demo
FROM python:3.11-slim

COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt /src \
    && rm -rf /src \
    && useradd --create-home fgrecon

USER fgrecon
WORKDIR /work
ENTRYPOINT ["fgrecon"]
CMD ["--help"]
