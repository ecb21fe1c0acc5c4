# fgrecon's command line: docker build -t fgrecon . && docker run --rm -v "$PWD:/data" fgrecon demo --out /data/demo
FROM python:3.11-slim

COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt /src \
    && rm -rf /src \
    && useradd --create-home fgrecon

USER fgrecon
WORKDIR /data
ENTRYPOINT ["fgrecon"]
CMD ["--help"]
