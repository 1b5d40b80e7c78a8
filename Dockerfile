# FreeArt-21 on a machine without a GPU: `docker build -t freeart21 .`, then `docker run --rm -v "$PWD/out:/freeart21/out" freeart21`
# records, reconstructs, exports and scores one object; the page is out/demo/index.html.
FROM python:3.11-slim-bookworm

RUN apt-get -qq update \
    && apt-get -qq install -y --no-install-recommends ca-certificates make \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /freeart21
COPY . .
RUN scripts/setup.sh

CMD ["make", "demo"]
