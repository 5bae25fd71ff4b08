# docker build -t vntoolkit .
# docker run --rm -v "$PWD:/work" vntoolkit doctor capture.mkv
FROM debian:trixie-slim
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
