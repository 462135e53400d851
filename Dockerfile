# A container that has all that the tests want: docker build --tag tripillar . && docker run --rm tripillar
FROM debian:12
RUN apt-get update \
    && apt-get install --yes --no-install-recommends \
        ca-certificates git make python3 python3-venv libegl1 libgl1 libxrender1 \
        gcc libc6-dev gcc-avr binutils-avr avr-libc libsimavr-dev libelf-dev chromium \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /tripillar
COPY . .
# torch without CUDA, which is gigabytes
RUN PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu make setup
CMD ["make", "test"]
