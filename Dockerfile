# eldata with its kernels compiled (for the processor that builds it), as a user of its own:
#   docker build --build-arg PIP_EXTRA_INDEX_URL -t eldata .    (the variable may name an index of CPU builds of PyTorch)
#   docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD:/work" eldata demo
FROM python:3.13-slim-bookworm
ARG PIP_EXTRA_INDEX_URL
COPY . /src/
RUN pip install --no-cache-dir --constraint /src/constraints.txt "/src[7z,compression]" \
  && useradd --create-home eldata && install --directory --owner eldata /var/cache/eldata /work
ENV NUMBA_CACHE_DIR=/var/cache/eldata/kernels MPLCONFIGDIR=/var/cache/eldata/matplotlib
USER eldata
# numba keeps nothing, and finds nothing, in a folder that its user, which --user may change, cannot write.
RUN eldata demo /tmp/demo --scenes 1 && rm -r /tmp/demo && chmod -R a+rwX /var/cache/eldata
WORKDIR /work
ENTRYPOINT ["eldata"]
CMD ["--help"]
