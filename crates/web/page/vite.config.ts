// Fixed file names, so that a rebuilt page can be compared with the built one; the gateway sends no file without asking for
// its age.
export default {
  build: {
    outDir: "out",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    rollupOptions: {
      output: { entryFileNames: "main.js", chunkFileNames: "[name].js", assetFileNames: "[name][extname]" },
    },
  },
};
