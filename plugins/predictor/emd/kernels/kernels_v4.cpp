// Compiled with -march=x86-64-v4 (CMakeLists.txt).
#define WEFT_STRING_(x) #x
#define WEFT_STRING(x) WEFT_STRING_(x)
#define WEFT_ISA v4
#define WEFT_WIDTH 16
#define WEFT_ROWS 12
#define WEFT_PRODUCTS "products_fma.inc"
#include "kernels.inc"
