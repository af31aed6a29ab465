// Compiled with -march=x86-64-v2 (CMakeLists.txt).
#define WEFT_STRING_(x) #x
#define WEFT_STRING(x) WEFT_STRING_(x)
#define WEFT_ISA v2
#define WEFT_WIDTH 4
#define WEFT_ROWS 4
#define WEFT_PRODUCTS "products_fma.inc"
#include "kernels.inc"
