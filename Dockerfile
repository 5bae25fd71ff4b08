# docker build -t vntoolkit .
# docker run --rm -v "$PWD:/work" vntoolkit doctor capture.mkv
# By digest, so that nobody can exchange it; `docker buildx imagetools inspect debian:trixie-slim` tells a newer one.
FROM debian:trixie-slim@sha256:a29215f6a35e51e22adffa17f89e9d2ef06214e64a2bad10d765c46aea49f11f
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates python3 python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/vntoolkit
COPY . .
RUN sh scripts/set_up.sh && rm -rf /var/lib/apt/lists/* /root/.cache
ENV PATH=/opt/vntoolkit/.venv/bin:$PATH
WORKDIR /work
ENTRYPOINT ["vntoolkit"]
CMD ["--help"]
