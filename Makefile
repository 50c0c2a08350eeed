# Everything a newcomer needs: `make demo` and `make test`. Both install what is missing and say so.

CARGO ?= cargo
# Seconds of processor time for each fuzzed reader, and which readers; all, if none is named.
FUZZ_SECONDS ?= 600
FUZZ_TARGETS ?=
# Cameras need libclang to build, so plain cargo leaves them out and every target here puts them in.
FEATURES ?= v4l
# Where pictures go, and what is seen on them; a synthetic street, if it is not said.
PICTURES ?= docs
SCENE ?=
# What is run for ARM: all that computes in inner loops or reads mapped numbers.
ARM_TESTS ?= kernel:: feature:: retrieval:: verification:: vocabulary:: storage:: kept_index:: cnn::preprocess

.PHONY: help demo test test-train test-data test-arm test-large test-crash test-camera camera-machine soak \
	screenshots benchmarks lint bench fuzz deps system-deps test-deps arm-deps picture-deps camera-deps fuzz-deps

help: ## What can be made
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

demo: deps ## Install what is missing, build, and run the main job on a synthetic drive
	$(CARGO) run --release --features $(FEATURES) -- demo

test: deps test-deps ## All tests that need no data from outside
	$(CARGO) test --no-default-features --lib
	$(CARGO) test --release --features $(FEATURES)

test-train: deps ## Tests of training, which other builds leave out; building it takes minutes
	$(CARGO) test --no-default-features --features train,cli --lib -- training:: onnx:: cnn::
	$(CARGO) test --no-default-features --features train,cli --test behaviour -- train::

test-data: deps ## Tests on real sequences, found by LOCI_DATA
	$(CARGO) test --release --features $(FEATURES) --test behaviour -- --ignored --nocapture real_

test-arm: arm-deps ## The inner loops for 64-bit ARM, with NEON, under an emulator; building them takes minutes
	CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
	CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64-static -L /usr/aarch64-linux-gnu" \
	$(CARGO) test --release --no-default-features --features cnn --target aarch64-unknown-linux-gnu --lib -- $(ARM_TESTS)

test-large: ## A training from a hundred million descriptors, its memory measured: minutes, and 3.3 GB of disk
	$(CARGO) test --release --no-default-features --test large_training -- --ignored --nocapture

test-crash: ## Runs killed 580 times; what they had answered must be in their maps: minutes
	$(CARGO) test --release --no-default-features --features cli --test crash -- --ignored --nocapture

test-camera: camera-machine ## Cameras that come and go, in a virtual machine: a minute, and minutes to build it
	tests/camera/run.sh

camera-machine: camera-deps ## The virtual machine of test-camera: a Debian kernel, loci without libraries, a drive
	CARGO="$(CARGO)" tests/camera/prepare.sh

soak: ## A million frames, or LOCI_SOAK_FRAMES; memory must stay flat: a quarter of an hour
	$(CARGO) test --release --no-default-features --test soak -- --ignored --nocapture

screenshots: deps picture-deps ## Pictures of rerun's viewer, of the source SCENE, into the folder PICTURES
	$(CARGO) build --release --features $(FEATURES)
	LOCI=$${CARGO_TARGET_DIR:-target}/release/loci docs/screenshots.sh "$(PICTURES)" $(if $(SCENE),"$(SCENE)")

benchmarks: deps ## Evaluate the suite on the data at LOCI_DATA and write BENCHMARKS.md
	$(CARGO) run --release --features $(FEATURES) -- evaluate --suite

lint: ## Formatting, clippy, licences and advisories, documentation
	$(CARGO) fmt --check
	$(CARGO) clippy --all-targets --features $(FEATURES) -- -D warnings
	$(CARGO) deny --all-features --log-level error check bans licenses sources
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --no-deps --features $(FEATURES)

bench: ## Criterion benches of the stages
	$(CARGO) bench --no-default-features

fuzz: fuzz-deps ## Made-up bytes for every reader, FUZZ_SECONDS each; see fuzz/README.md
	FUZZ_SECONDS=$(FUZZ_SECONDS) fuzz/run.sh $(FUZZ_TARGETS)

deps: system-deps ## ONNX Runtime and what the build needs
	@deploy/fetch-onnxruntime.sh

test-deps: ## Debian or Ubuntu packages that the tests need: ffmpeg makes and reads videos
	@deploy/install-packages.sh ffmpeg

system-deps: ## Debian or Ubuntu packages that are missing
	@deploy/install-packages.sh libclang-dev python3 python3-pip

arm-deps: ## Rust's library for 64-bit ARM, a linker, and the emulator
	@deploy/install-packages.sh gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static
	@rustup target add aarch64-unknown-linux-gnu

picture-deps: ## What shows a viewer without a display; the viewer is rerun-sdk 0.36.3 from PyPI, or RERUN_VIEWER
	@deploy/install-packages.sh xvfb xauth mesa-vulkan-drivers ffmpeg

camera-deps: ## What the virtual machine is made of and runs in
	@deploy/install-packages.sh qemu-system-x86 busybox-static cpio kmod xz-utils make gcc libc6-dev libelf-dev \
		libclang-dev python3

fuzz-deps: ## cargo-fuzz and the C++ compiler that libFuzzer needs
	@deploy/install-packages.sh g++
	@command -v cargo-fuzz >/dev/null || $(CARGO) install cargo-fuzz --locked --version 0.13.2
