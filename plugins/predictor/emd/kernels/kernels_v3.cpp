// Compiled with -march=x86-64-v3 (CMakeLists.txt).
#define WEFT_STRING_(x) #x
#define WEFT_STRING(x) WEFT_STRING_(x)
#define WEFT_ISA v3
#define WEFT_WIDTH 8
#define WEFT_ROWS 6
#define WEFT_PRODUCTS "products_fma.inc"
#include "kernels.inc"
