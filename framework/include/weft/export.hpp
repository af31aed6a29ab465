#pragma once
// weft is built with -fvisibility=hidden. This marks the names that other libraries can see.
#define WEFT_API __attribute__((visibility("default")))
