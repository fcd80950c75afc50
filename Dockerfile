# An image that runs `simnfnd`, by default `simnfnd demo`:
#   docker build -t simnfnd .
#   docker run --rm -v "$PWD/outputs:/data/outputs" simnfnd
#   docker build --target denoise -t simnfnd-denoise .      # denoising alone, without Blender and torch
#   docker run --rm -v "$PWD:/data" simnfnd-denoise dive.aris --out denoised
FROM python:3.11-slim-bookworm AS source
COPY pyproject.toml setup.py constraints.txt README.md LICENSE /src/
COPY simnfnd /src/simnfnd
COPY factory /src/factory
COPY models /src/models
COPY evaluation /src/evaluation
COPY conf /src/conf

FROM python:3.11-slim-bookworm AS denoise
RUN --mount=type=bind,from=source,source=/src,target=/src,rw \
    pip install --no-cache-dir --no-compile -c /src/constraints.txt "/src[denoise]" \
    && python -c "import simnfnd.models.denoise.temporal.kernels"  # compiles its loops
RUN useradd --create-home user
USER user
WORKDIR /data
ENTRYPOINT ["simnfnd", "denoise"]
CMD ["--help"]

FROM python:3.11-slim-bookworm

# What Blender's and Open3D's wheels load and do not carry.
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 \
        libegl1 libusb-1.0-0 libgomp1 \
    && rm -rf /var/lib/apt/lists/*

# Everything in one call, so that numpy stays where bpy can load it.  PIP_ARGS: options of that call;
# name the index of torch's CPU builds there, or torch brings gigabytes of CUDA libraries:
#   docker build --build-arg PIP_ARGS="--extra-index-url URL" -t simnfnd .
ARG PIP_ARGS=""
RUN --mount=type=bind,from=source,source=/src,target=/src,rw \
    pip install --no-cache-dir ${PIP_ARGS} -c /src/constraints.txt "/src[all]"

RUN useradd --create-home user && mkdir -p /data/outputs && chown -R user /data
USER user
WORKDIR /data
VOLUME /data/outputs
ENTRYPOINT ["simnfnd"]
CMD ["demo"]
