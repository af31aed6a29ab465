#pragma once
// Built with -fvisibility=hidden; these mark what crosses library boundaries.
#define WEFT_API __attribute__((visibility("default")))
