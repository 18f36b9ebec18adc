#!/bin/bash -eu
# Copyright 2026 Google LLC
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#      http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
#
################################################################################

cd "$SRC/bevy_vdb"

# Overflows are findings, too.
cargo fuzz build --release --debug-assertions

programs=${CARGO_TARGET_DIR:-fuzz/target}/x86_64-unknown-linux-gnu/release
inputs=$(mktemp -d)
for target in $(cargo fuzz list); do
    cp "$programs/$target" "$OUT/"
    fuzz/first_inputs "$target" "$inputs/$target"
    # A target without seeds starts with an empty corpus.
    rmdir "$inputs/$target" 2>/dev/null ||
        zip --quiet --junk-paths --recurse-paths "$OUT/${target}_seed_corpus.zip" "$inputs/$target"
    # The limits of scripts/fuzz: what takes longer, or more memory, breaks the promise of vdb_core::Limits.
    cat >"$OUT/$target.options" <<OPTIONS
[libfuzzer]
rss_limit_mb = 2048
malloc_limit_mb = 512
timeout = 10
OPTIONS
done
rm -rf "$inputs"
