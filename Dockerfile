# The two commands of README.md in a container:
#   docker build -t night .
#   docker run --rm night make demo
#   docker run --rm night make test
FROM debian:bookworm-slim
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        ca-certificates git make python3.11 python3.11-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /night
COPY . .
RUN make setup
CMD ["make", "demo"]
